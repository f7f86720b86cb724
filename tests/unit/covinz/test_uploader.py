"""The pauses of the uploader and a failing spool; more of its behaviour is in test_agent.py."""

from __future__ import annotations

import random
import time
from pathlib import Path

from covinz import codec, keyexprs
from covinz.config import AgentConfig
from covinz.memory_bus import Hub, InMemoryBus
from covinz.spool import Spool, SpoolError
from covinz.spool_rows import SpoolEntry
from covinz.types import Stored
from covinz.uploader import Backoff, Uploader
from tests.local_ingest import WAIT_S
from tests.uploads import CAMERA, keyframe, message


def test_pauses_double_up_to_the_limit_and_scatter() -> None:
    config = AgentConfig(min_backoff_s=0.1, max_backoff_s=1.0)
    pauses: list[list[float]] = []
    for seed in range(50):
        backoff = Backoff(config, random.Random(seed))
        pauses.append([backoff.failed() for _ in range(6)])
    for step, limit in zip(zip(*pauses, strict=True), (0.1, 0.2, 0.4, 0.8, 1.0, 1.0), strict=True):
        assert 0.5 * limit <= min(step) < 0.6 * limit
        assert 0.9 * limit < max(step) <= limit


def test_a_success_ends_the_growth() -> None:
    backoff = Backoff(AgentConfig(min_backoff_s=0.1, max_backoff_s=1.0), random.Random(0))
    for _ in range(4):
        backoff.failed()
    backoff.reset()
    assert backoff.failed() <= 0.1


class FlakySpool(Spool):
    """A spool whose disk cannot be read when the calibration is wanted for the first time."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "a0", AgentConfig())
        self.failures = 0

    def camera(self, camera_hash: str) -> bytes:
        if not self.failures:
            self.failures += 1
            raise SpoolError("disk I/O error")
        return super().camera(camera_hash)


def test_a_spool_that_cannot_be_read_for_once_is_tried_again(tmp_path: Path) -> None:
    hub = Hub()
    server, robot = hub.join(), hub.join()
    for key in (keyexprs.AGENT_CAMERAS, keyexprs.AGENT_KEYFRAMES):
        server.answer(key, lambda query: query.reply(codec.encode(Stored())))
    spool = FlakySpool(tmp_path / "spool")
    spool.append([SpoolEntry(keyframe().id, 0, message(), CAMERA.hash, codec.encode(CAMERA))])
    config = AgentConfig(window=1, min_backoff_s=0.001, max_backoff_s=0.01)
    uploader = Uploader(robot, spool, "a0", config, lambda row, answer: None)
    uploader.start()
    assert uploader.wait_empty(WAIT_S)
    assert spool.failures == 1
    uploader.stop(WAIT_S)
    spool.close()
    robot.close()
    server.close()


class BrokenBus(InMemoryBus):
    """Fails in a way of its own the first few times that it is asked."""

    failures = 6

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        if self.failures:
            self.failures -= 1
            raise RuntimeError("the link broke in a way that nobody thought of")
        return super().ask(key, payload, timeout_s)


def test_no_mistake_ends_the_uploads(tmp_path: Path) -> None:
    hub = Hub()
    server, robot = hub.join(), BrokenBus(hub)
    for key in (keyexprs.AGENT_CAMERAS, keyexprs.AGENT_KEYFRAMES):
        server.answer(key, lambda query: query.reply(codec.encode(Stored())))
    spool = Spool(tmp_path / "spool", "a0", AgentConfig())
    spool.append([SpoolEntry(keyframe().id, 0, message(), CAMERA.hash, codec.encode(CAMERA))])
    config = AgentConfig(window=2, min_backoff_s=0.001, max_backoff_s=0.01)
    uploader = Uploader(robot, spool, "a0", config, lambda row, answer: None)
    uploader.start()
    assert uploader.wait_empty(WAIT_S)
    uploader.stop(WAIT_S)
    spool.close()
    robot.close()
    server.close()


def test_a_keyframe_whose_calibration_is_lost_stops_nobody(tmp_path: Path) -> None:
    hub = Hub()
    server, robot = hub.join(), hub.join()
    for key in (keyexprs.AGENT_CAMERAS, keyexprs.AGENT_KEYFRAMES):
        server.answer(key, lambda query: query.reply(codec.encode(Stored())))
    spool = Spool(tmp_path / "spool", "a0", AgentConfig())
    for seq, camera in enumerate(["lost", CAMERA.hash, CAMERA.hash]):
        name = keyframe(seq).id
        spool.append([SpoolEntry(name, 0, message(seq), camera, codec.encode(CAMERA))])
    spool._file.db.execute("DELETE FROM camera WHERE hash = 'lost'")
    config = AgentConfig(window=1, min_backoff_s=0.001, max_backoff_s=0.01)
    uploader = Uploader(robot, spool, "a0", config, lambda row, answer: None)
    uploader.start()
    deadline = time.monotonic() + WAIT_S
    while len(spool) > 1 and time.monotonic() < deadline:
        uploader.wait_empty(0.01)
    assert len(spool) == 1
    uploader.stop(WAIT_S)
    row = spool.take()
    assert row is not None and row.first_seq == 0
    spool.close()
    robot.close()
    server.close()


def test_a_pause_that_the_server_asked_for_scatters_and_is_not_cut() -> None:
    config = AgentConfig(min_backoff_s=0.1, max_backoff_s=1.0)
    pauses = [Backoff(config, random.Random(seed)).asked(2.0) for seed in range(50)]
    assert 2.0 <= min(pauses) < 2.1
    assert 2.4 < max(pauses) <= 2.5
