"""Claim: SIFT closes loops between views so different that ORB closes few (COVINS-G, IV-E).

Plays scenarios/wide_baseline.yaml in lockstep by each kind of feature, with either profile of the
loop solver, and keeps of every report what became of the candidates. Images are rendered where they
are not in the cache yet. In lockstep a run is reproducible but for its times.

    python -m benchmarks.feature_kinds [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

_REPOSITORY = Path(__file__).resolve().parents[1]
_SCENARIO = _REPOSITORY / "scenarios" / "wide_baseline.yaml"
_KINDS: dict[str, list[str]] = {"orb": ["orb"], "sift": ["sift"], "both": ["orb", "sift"]}
_PROFILES = ("fast", "paper")


def run(kinds: list[str], profile: str, folder: Path) -> dict[str, Any]:
    """The report of one run, which leaves its files in a folder that is not there yet."""
    scenario = yaml.safe_load(_SCENARIO.read_text())
    scenario["defaults"]["features"] = kinds
    file = folder.with_suffix(".yaml")
    file.write_text(yaml.safe_dump(scenario))
    command = [sys.executable, "-m", "covinz.cli", "run", str(file)]
    subprocess.run(
        [*command, "--lockstep", "--profile", profile, "--out", str(folder)],
        cwd=_REPOSITORY,
        stdout=sys.stderr,
        check=True,
    )
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report


def figures(report: Mapping[str, Any]) -> dict[str, Any]:
    """What is kept of a report."""
    agents = report["agents"].values()
    kept = ("maps", "joint_ate_before_m", "joint_ate_after_m", "solver_ms")
    keyframes = sum(agent["keyframes"] for agent in agents)
    sent_bytes = sum(agent["bytes"] for agent in agents)
    return {
        **{name: report[name] for name in kept},
        "loops": report["loops"],
        "keyframes": keyframes,
        "kB_per_keyframe": sent_bytes / keyframes / 1000,
    }


def measure(folder: Path) -> dict[str, Any]:
    """All runs: ``runs.<kinds>.<profile>``."""
    runs = {
        name: {
            profile: figures(run(kinds, profile, folder / f"{name}-{profile}"))
            for profile in _PROFILES
        }
        for name, kinds in _KINDS.items()
    }
    return {"benchmark": "feature_kinds", "machine": platform.machine(), "runs": runs}


def main() -> None:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        report = json.dumps(measure(Path(folder)), indent=2) + "\n"
    sys.stdout.write(report)
    if arguments.out:
        arguments.out.write_text(report)


if __name__ == "__main__":
    main()
