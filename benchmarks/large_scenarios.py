"""Claim: what holds for the demo holds for five robots, outdoors over 2.4 km, and on real odometry.

Runs the repository's larger scenarios with `covinz run --lockstep`, keeps their reports and, for
`docs/results.md`, their pictures from above. Images are rendered where they are not in the cache
yet: the first run takes long. In lockstep a run is reproducible; times are those of one worker.

    python -m benchmarks.large_scenarios [--out FILE] [--pictures FOLDER] [--runs FOLDER] [NAME ...]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

_REPOSITORY = Path(__file__).resolve().parents[1]
_DATA = Path(os.environ.get("COVINZ_DATA", _REPOSITORY.parent / "shared" / "data"))
# Scenario, and the data that it needs.
_SCENARIOS = {"hall5": None, "courtyard": None, "machine_hall": "euroc_trajectories"}


def run(name: str, folder: Path) -> dict[str, Any]:
    """The report of one run, which leaves its files in a folder that is not there yet."""
    command = [sys.executable, "-m", "covinz.cli", "run", f"scenarios/{name}.yaml"]
    subprocess.run(
        [*command, "--lockstep", "--out", str(folder.resolve())],
        cwd=_REPOSITORY,
        env=dict(os.environ, COVINZ_DATA=str(_DATA)),
        stdout=sys.stderr,
        check=True,
    )
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report


def main() -> None:
    """Measure, print and write JSON; what is not run again keeps its report in the file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenarios; by default all")
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    parser.add_argument("--pictures", type=Path, help="folder for the pictures")
    parser.add_argument("--runs", type=Path, help="folder in which the runs are kept")
    arguments = parser.parse_args()
    reports: dict[str, Any] = {}
    if arguments.out and arguments.out.exists():
        reports = json.loads(arguments.out.read_text())["reports"]
    for name, data in _SCENARIOS.items():
        if arguments.names and name not in arguments.names:
            continue
        if data is not None and not (_DATA / data).is_dir():
            continue
        with tempfile.TemporaryDirectory() as temporary:
            folder = (arguments.runs or Path(temporary)) / name
            reports[name] = run(name, folder)
            if arguments.pictures:
                picture = arguments.pictures / f"{name}_top_view.png"
                shutil.copyfile(folder / "top_view.png", picture)
    ordered = {name: reports[name] for name in _SCENARIOS if name in reports}
    made = {"benchmark": "large_scenarios", "machine": platform.machine(), "reports": ordered}
    text = json.dumps(made, indent=2) + "\n"
    sys.stdout.write(text)
    if arguments.out:
        arguments.out.write_text(text)


if __name__ == "__main__":
    main()
