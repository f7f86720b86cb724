"""What a finished run leaves in its folder: report, trajectories, graphs, candidates, pictures."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from covinz import export, g2o
from covinz.candidates import candidates, write_candidates
from covinz.record import RunRecord
from covinz.trajectory import write_tum
from covinz.types import MapSnapshot

log = logging.getLogger(__name__)


def write(folder: Path, record: RunRecord, made: Mapping[str, Any]) -> list[Path]:
    """Write everything; returns the files, the report first.

    Raises:
        OSError: If something cannot be written.
    """
    report = folder / "report.json"
    report.write_text(json.dumps(made, indent=2) + "\n")
    files = [report, *_write_maps(folder, record.snapshots)]
    files.append(folder / "candidates.csv")
    write_candidates(files[-1], candidates(record.jobs, record.true_poses()))
    return files + draw(folder, record, made)


def draw(folder: Path, record: RunRecord, made: Mapping[str, Any]) -> list[Path]:
    """Draw the pictures; where drawing is not installed there are none."""
    try:
        # Robots and servers, which never draw, are installed without matplotlib.
        from covinz import pictures
    except ModuleNotFoundError as error:
        log.warning("no pictures: %s; pip install 'covinz[pictures]' brings them", error)
        return []
    return pictures.draw(record, made, folder)


def _write_maps(folder: Path, snapshots: Sequence[MapSnapshot]) -> Iterator[Path]:
    trajectories = folder / "trajectories"
    trajectories.mkdir()
    for name, odometry in (("before", True), ("after", False)):
        for agent, path in export.trajectories(snapshots, odometry=odometry).items():
            write_tum(trajectories / f"{agent}.{name}.tum", path)
    yield trajectories
    for number, snapshot in enumerate(snapshots):
        suffix = "" if number == 0 else f"-{number + 1}"
        yield folder / f"map{suffix}.g2o"
        g2o.write_g2o(folder / f"map{suffix}.g2o", snapshot)
