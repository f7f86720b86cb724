"""Puts the pictures of a finished run where the README and docs/ show them.

python -m benchmarks.pictures [RUN] [--out docs/pictures]

RUN is a run's folder; without it, the latest run is taken.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path

_REPOSITORY = Path(__file__).resolve().parents[1]
_PICTURES = ("top_view.png", "map_3d.png", "error_over_time.png", "loops.png")
# A README that loads slowly is not read. [bytes]
_LARGEST = 300_000


def copy_pictures(run: Path, out: Path) -> list[Path]:
    """Copy the pictures of a run as ``<scenario>_<picture>.png``; returns the copies.

    Raises:
        SystemExit: If the run is not finished, lost keyframes or has a picture that is too large.
    """
    report = run / "report.json"
    if not report.is_file():
        raise SystemExit(f"{run} is not the folder of a finished run: it has no report.json")
    made = json.loads(report.read_text())
    if made["keyframes_lost"]:
        raise SystemExit(f"{run} lost {made['keyframes_lost']} keyframes; it is not shown")
    out.mkdir(parents=True, exist_ok=True)
    copies = []
    for name in _PICTURES:
        if (run / name).stat().st_size > _LARGEST:
            raise SystemExit(f"{run / name} is larger than {_LARGEST // 1000} kB")
        copies.append(out / f"{made['scenario']}_{name}")
        shutil.copyfile(run / name, copies[-1])
    return copies


def main() -> None:
    """Copy and name the copies."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path, nargs="?", default=_REPOSITORY / "runs" / "latest")
    parser.add_argument("--out", type=Path, default=_REPOSITORY / "docs" / "pictures")
    arguments = parser.parse_args()
    for file in copy_pictures(arguments.run, arguments.out):
        sys.stdout.write(f"{file}\n")


if __name__ == "__main__":
    main()
