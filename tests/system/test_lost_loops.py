"""The optimizer's file is lost, or older than the journal of jobs: the maps are the same again."""

from __future__ import annotations

from pathlib import Path

import pytest
from covinz_agents.rendered import RenderedRobot

from covinz import client
from covinz.types import Keyframe, LoopClosure, MapSnapshot
from tests.system import test_jobs
from tests.system.test_jobs import System, stop

pytestmark = pytest.mark.slow

config_file, recording, system = test_jobs.config_file, test_jobs.recording, test_jobs.system


def settled_maps(system: System) -> list[MapSnapshot]:
    system.until("the maps are done", lambda: client.progress(system.bus).idle)
    return client.snapshots(system.bus)


def bits(snapshots: list[MapSnapshot]) -> list[tuple[object, ...]]:
    names = ("T_map_body", "T_from_to", "information", "edge_from", "edge_to", "is_loop")
    return [(s.keyframes, *(getattr(s, name).tobytes() for name in names)) for s in snapshots]


def copy(source: Path, target: Path) -> None:
    target.mkdir(exist_ok=True)
    for file in source.glob("optimizer.sqlite*"):
        (target / file.name).write_bytes(file.read_bytes())


def forget(system: System) -> None:
    for file in system.data.glob("optimizer.sqlite*"):
        file.unlink()


def test_loops_that_the_optimizer_lost_come_from_the_journal(
    system: System, recording: list[tuple[RenderedRobot, Keyframe]], tmp_path: Path
) -> None:
    optimizer = system.start("optimizer")
    system.until("there is a log", lambda: system.status("optimizer") is not None)
    system.start("place_recognition")
    system.until("there is a journal", lambda: not client.progress(system.bus).dirty)
    stop(optimizer)
    copy(system.data, tmp_path / "backup")  # of a time without loops
    optimizer = system.start("optimizer")
    system.start("loop_solver", "worker-0")
    records = system.all_jobs_done(len(recording))
    accepted = sum(isinstance(record.outcome, LoopClosure) for record in records)
    assert accepted >= 5
    before = settled_maps(system)

    for backup in (None, tmp_path / "backup"):
        optimizer.kill()
        optimizer.wait()
        forget(system)
        if backup is not None:
            copy(backup, system.data)
        optimizer = system.start("optimizer")
        assert bits(settled_maps(system)) == bits(before)
        status = system.status("optimizer")
        assert status is not None and status.counters["recovered_loops"] == accepted
