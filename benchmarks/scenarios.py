"""Claim: robots that know nothing of each other end up in one map, from keyframes alone.

Runs the scenarios on real images with `covinz run --lockstep` and keeps their reports. In lockstep
a run is reproducible, so that figures of accuracy need one run; times are those of one worker.

    python -m benchmarks.scenarios [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

_REPOSITORY = Path(__file__).resolve().parents[1]
_DATA = Path(os.environ.get("COVINZ_DATA", _REPOSITORY.parent / "shared" / "data"))
# Scenario, and the recording that it needs. The generated ones are measured by demo.py and
# large_scenarios.py.
_SCENARIOS = (("redkitchen", "redkitchen"), ("fr1_rpy", "fr1_rpy"))


def run(name: str) -> dict[str, Any]:
    """The report of one run."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / name
        command = [sys.executable, "-m", "covinz.cli", "run", f"scenarios/{name}.yaml"]
        subprocess.run(
            [*command, "--lockstep", "--out", str(out)],
            cwd=_REPOSITORY,
            env=dict(os.environ, COVINZ_DATA=str(_DATA)),
            stdout=sys.stderr,
            check=True,
        )
        report: dict[str, Any] = json.loads((out / "report.json").read_text())
        return report


def main() -> None:
    """Measure, print and write JSON; scenarios without their recording are left out."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    reports = {name: run(name) for name, recording in _SCENARIOS if (_DATA / recording).is_dir()}
    made = {"benchmark": "scenarios", "machine": platform.machine(), "reports": reports}
    text = json.dumps(made, indent=2) + "\n"
    sys.stdout.write(text)
    if arguments.out:
        arguments.out.write_text(text)


if __name__ == "__main__":
    main()
