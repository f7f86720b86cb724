"""An ingest whose file was replaced by an older copy of itself: everybody notices."""

from __future__ import annotations

import dataclasses
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from covinz import client, codec, keyexprs
from covinz.types import LoopClosure, RetryAfter, Stored
from tests.fleets import closure, keyframe
from tests.processes import PATIENCE_S, Processes
from tests.uploads import CAMERA, features

CONSUMERS = ("place_recognition", "optimizer")


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Processes]:
    with Processes(tmp_path) as server:
        server.start("router", "ingest", *CONSUMERS)
        yield server


def upload(server: Processes, agent: str, seqs: range) -> None:
    """As a robot does, without a spool: what was acknowledged is forgotten."""
    assert server.bus.ask(keyexprs.agent_camera(agent), codec.encode(CAMERA))
    for seq in seqs:
        kf = dataclasses.replace(
            keyframe(agent, 0, seq), camera_hash=CAMERA.hash, features=features(seed=seq)
        )
        (reply,) = server.bus.ask(keyexprs.agent_keyframe(agent), codec.encode(kf))
        assert codec.decode_upload_reply(reply) == Stored()


def bring(server: Processes, loop: LoopClosure) -> None:
    """As a worker does."""
    deadline_s, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while True:
        (reply,) = server.bus.ask(keyexprs.LOOP, codec.encode(loop))
        if not isinstance(codec.decode_upload_reply(reply), RetryAfter):
            return
        assert time.monotonic() < deadline_s
        pause.wait(0.1)


def wait_idle(server: Processes) -> None:
    """Until all that are there have read the log that there is now, and have nothing to do."""
    deadline_s, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while not client.progress(server.bus).idle:
        assert time.monotonic() < deadline_s, client.progress(server.bus)
        pause.wait(0.05)


def wait_for_another_log(server: Processes, known: str) -> None:
    deadline_s, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while server.status("ingest").log_id == known:
        assert time.monotonic() < deadline_s
        pause.wait(0.05)


def keep(server: Processes, folder: Path) -> None:
    """A copy of the log, as an administrator makes it."""
    assert server.stop("ingest") == 0
    folder.mkdir()
    for file in server.data.glob("ingest.sqlite*"):
        shutil.copy(file, folder)
    server.start("ingest")


def bring_back(server: Processes, folder: Path) -> None:
    for file in server.data.glob("ingest.sqlite*"):
        file.unlink()
    for file in folder.iterdir():
        shutil.copy(file, server.data)


@pytest.mark.parametrize("consumers_run", [True, False])
@pytest.mark.parametrize("num_new", [0, 3, 10])
def test_consumers_of_a_log_that_went_back_start_over(
    server: Processes, tmp_path: Path, num_new: int, consumers_run: bool
) -> None:
    upload(server, "a", range(5))
    keep(server, tmp_path / "kept")
    upload(server, "b", range(6))
    bring(server, closure(keyframe("b", 0, 5).id, keyframe("a", 0, 1).id))
    wait_idle(server)
    assert server.status("optimizer").counters["loops"] == 1
    first = server.status("ingest").log_id

    if not consumers_run:
        for name in CONSUMERS:
            assert server.stop(name) == 0
    assert server.stop("ingest") == 0
    bring_back(server, tmp_path / "kept")
    server.start("ingest")
    upload(server, "c", range(num_new))  # other keyframes at the same indices, or beyond
    if not consumers_run:
        server.start(*CONSUMERS)
    wait_for_another_log(server, first)
    wait_idle(server)

    assert server.status("ingest").cursor == 5 + num_new
    for name in CONSUMERS:
        assert server.status(name).log_id == server.status("ingest").log_id
    status = server.status("optimizer")
    assert (status.counters["loops"], status.pending) == (0, 0)
    assert server.log_of("ingest").count(f"this is not the log {first}") == 1
    agents = {segment.agent for summary in client.maps(server.bus) for segment in summary.segments}
    assert agents == ({"a", "c"} if num_new else {"a"})
