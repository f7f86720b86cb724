"""Claim: the demo puts three robots into one map that is three times better than their odometry.

Runs scenarios/hall.yaml with `covinz run --lockstep` for three seeds, i.e. for other paths, drift
and image noise, and keeps their reports; every figure is exact, the ground truth being generated.

    python -m benchmarks.demo [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

_REPOSITORY = Path(__file__).resolve().parents[1]
_SEEDS = (0, 1, 2)


def run(seed: int) -> dict[str, Any]:
    """The report of one run."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "hall"
        command = [sys.executable, "-m", "covinz.cli", "run", "scenarios/hall.yaml"]
        command += ["--lockstep", "--workers", "2", "--seed", str(seed), "--out", str(out)]
        subprocess.run(command, cwd=_REPOSITORY, stdout=sys.stderr, check=True)
        report: dict[str, Any] = json.loads((out / "report.json").read_text())
        return report


def worst(reports: dict[int, dict[str, Any]]) -> dict[str, Any]:
    """Of every figure that the demo promises, the worst of all seeds."""
    found = reports.values()
    loops = [report["loops"] for report in found]
    return {
        "maps": max(len(report["maps"]) for report in found),
        "keyframes_lost": max(report["keyframes_lost"] for report in found),
        "wrong_share": round(max(loop["wrong"] / loop["accepted"] for loop in loops), 4),
        "wrong_bending": max(loop["wrong_bending"] for loop in loops),
        "ate_ratio": round(
            max(report["joint_ate_after_m"] / report["joint_ate_before_m"] for report in found), 3
        ),
        "joint_ate_after_m": max(report["joint_ate_after_m"] for report in found),
    }


def main() -> None:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    reports = {seed: run(seed) for seed in _SEEDS}
    made = {
        "benchmark": "demo",
        "machine": platform.machine(),
        "worst": worst(reports),
        "reports": {str(seed): report for seed, report in reports.items()},
    }
    text = json.dumps(made, indent=2) + "\n"
    sys.stdout.write(text)
    if arguments.out:
        arguments.out.write_text(text)


if __name__ == "__main__":
    main()
