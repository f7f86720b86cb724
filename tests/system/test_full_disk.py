"""A full disk under real processes: nothing acknowledged is lost, and they go on by themselves."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path

import pytest

from covinz import codec, keyexprs
from covinz.agent import Agent
from covinz.types import Keyframe, LoopClosure, RetryAfter, Stored, UploadReply
from services.optimizer.doors import RETRY_AFTER_S
from tests import disks
from tests.fleets import closure, session
from tests.processes import PATIENCE_S, Processes
from tests.uploads import CAMERA, content

# 36 kB each, so that a hundred do not fit on what is left.
NUM_FEATURES = 1000
# A full disk is noticed and tried again so often; much later would be a stall. [s]
RECOVERY_S = 30.0

Fill = Callable[[Processes], Callable[[], object]]


def fill_file_system(server: Processes) -> Callable[[], object]:
    return disks.fill(server.data)


def limit_ingest(server: Processes) -> Callable[[], object]:
    size = max(file.stat().st_size for file in server.data.glob("ingest.sqlite*"))
    return disks.limit_files(server.pid("ingest"), size)


@contextmanager
def started(folder: Path, *names: str) -> Iterator[Processes]:
    with Processes(folder) as server:
        server.start(*names)
        yield server


@pytest.mark.parametrize(
    ("fill", "trouble"), [(fill_file_system, "disk_full"), (limit_ingest, "other")]
)
def test_ingest_on_a_full_disk_keeps_what_it_acknowledged_and_goes_on_by_itself(
    tmp_path: Path, fill: Fill, trouble: str
) -> None:
    with _disk(tmp_path, fill), started(tmp_path, "router", "ingest") as server:
        pid = server.pid("ingest")
        with Agent("a0", server.endpoint, tmp_path / "a0.spool") as agent:
            sent = [agent.send(content(k, num_features=NUM_FEATURES)) for k in range(5)]
            assert agent.wait_delivered(PATIENCE_S)
            make_room = fill(server)
            sent += [agent.send(content(k, num_features=NUM_FEATURES)) for k in range(5, 105)]
            _until(lambda: f"cannot_store.{trouble}" in server.status("ingest").counters)
            head = server.status("ingest").cursor
            assert 5 <= head < 105
            assert agent.pending == 105 - head
            assert len(server.log_entries()) == head  # what it has it hands out
            make_room()
            assert agent.wait_delivered(RECOVERY_S)
        entries = [entry.item for entry in server.log_entries()]
        stored = [item.id for item in entries if isinstance(item, Keyframe)]
        assert sorted(stored) == sorted(sent)
        assert f"cannot_store.{trouble}" not in server.status("ingest").counters
        assert server.pid("ingest") == pid
        log = server.log_of("ingest")
        assert log.count("uploads are not stored, and robots keep them") == 1
        assert log.count("uploads are stored again") == 1


def test_the_answer_says_why(tmp_path: Path) -> None:
    with (
        disks.small_file_system(tmp_path / "data"),
        started(tmp_path, "router", "ingest") as server,
    ):
        disks.fill(server.data)
        answers = [_camera(server, k) for k in range(200)]
        refused = [answer for answer in answers if answer != Stored()]
        assert refused
        assert set(refused) == {RetryAfter(2.0, "the server's disk is full")}


def test_the_optimizer_on_a_full_disk_acks_nothing_and_goes_on_by_itself(tmp_path: Path) -> None:
    data = tmp_path / "data"
    with (
        disks.small_file_system(data),
        started(tmp_path, "router", "ingest", "place_recognition", "optimizer") as server,
    ):
        with Agent("a0", server.endpoint, tmp_path / "a0.spool", session=session(0)) as agent:
            sent = [agent.send(content(k)) for k in range(40)]
            assert agent.wait_delivered(PATIENCE_S)
        pid = server.pid("optimizer")
        make_room = disks.fill(data)
        loops = [closure(sent[k + 20], sent[k], job_id=f"{k:032x}") for k in range(20)]
        full = RetryAfter(RETRY_AFTER_S, "the server's disk is full")
        assert full in [_bring(server, loop) for loop in loops * 40]
        assert "cannot_store.disk_full" in server.status("optimizer").counters
        make_room()
        for loop in loops:
            _until(partial(_is_taken, server, loop))
        _until(lambda: not server.status("optimizer").dirty)
        assert server.status("optimizer").counters["loops"] == len(loops)
        assert server.pid("optimizer") == pid


def _disk(folder: Path, fill: Fill) -> AbstractContextManager[None]:
    return disks.small_file_system(folder / "data") if fill is fill_file_system else nullcontext()


def _camera(server: Processes, number: int) -> UploadReply:
    camera = dataclasses.replace(CAMERA, width=CAMERA.width + number)
    (reply,) = server.bus.ask(keyexprs.agent_camera("a0"), codec.encode(camera))
    return codec.decode_upload_reply(reply)


def _bring(server: Processes, loop: LoopClosure) -> UploadReply:
    (reply,) = server.bus.ask(keyexprs.LOOP, codec.encode(loop))
    return codec.decode_upload_reply(reply)


def _is_taken(server: Processes, loop: LoopClosure) -> bool:
    return not isinstance(_bring(server, loop), RetryAfter)


def _until(holds: Callable[[], bool], patience_s: float = RECOVERY_S) -> None:
    """Ask again and again; nothing says when a status changes."""
    deadline_s, pause = time.monotonic() + patience_s, threading.Event()
    while not holds():
        assert time.monotonic() < deadline_s
        pause.wait(0.05)
