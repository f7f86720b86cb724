"""The ingest service on an in-memory bus: group commit, counters, overload, restarts."""

from __future__ import annotations

import dataclasses
import queue
import sqlite3
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from covinz import codec, keyexprs
from covinz.config import IngestConfig
from covinz.memory_bus import Hub, InMemoryBus
from covinz.service import Inbox, StatusRequest
from covinz.types import (
    Camera,
    Duplicate,
    Gap,
    LogHead,
    NeedCamera,
    Rejected,
    RetryAfter,
    Status,
    Stored,
    UploadReply,
)
from services.ingest.agent_book import AgentBook
from services.ingest.intake import Intake, Upload
from services.ingest.keyframe_log import KeyframeLog
from services.ingest.service import Ingest
from tests.local_ingest import WAIT_S, LocalIngest
from tests.uploads import CAMERA, SESSION, keyframe, message


class Question:
    """A query that keeps its answer."""

    def __init__(self, payload: bytes, key: str) -> None:
        self.key = key
        self.payload = payload
        self.answers: list[bytes] = []

    def reply(self, payload: bytes) -> None:
        self.answers.append(payload)

    def drop(self) -> None:
        raise AssertionError("ingest answers every upload")

    @property
    def answer(self) -> UploadReply:
        (payload,) = self.answers
        return codec.decode_upload_reply(payload)


def keyframe_question(seq: int, agent: str = "a0") -> Question:
    return Question(message(seq, agent), keyexprs.agent_keyframe(agent))


def camera_question(agent: str = "a0", camera: Camera = CAMERA) -> Question:
    return Question(codec.encode(camera), keyexprs.agent_camera(agent))


class Bench:
    """Ingest without its thread: uploads are taken in and handled when the test says so."""

    def __init__(self, path: Path, config: IngestConfig) -> None:
        self.inbox = Inbox()
        self.intake = Intake(self.inbox, config)
        self.log = KeyframeLog(path, busy_timeout_s=0.05)
        self.hub = Hub()
        self.bus = self.hub.join()
        self.book = AgentBook("ingest", min_features=3)
        self.ingest = Ingest(self.log, self.intake, self.bus, config, "ingest", self.book)

    def handle(self, *questions: Question) -> list[UploadReply]:
        for question in questions:
            is_camera = question.key.endswith("/camera")
            (self.intake.on_camera if is_camera else self.intake.on_keyframe)(question)
        self.ingest.handle(self.inbox.drain(1000))
        return [question.answer for question in questions]

    def close(self) -> None:
        self.bus.close()
        self.log.close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ingest.sqlite"


@pytest.fixture
def bench(path: Path) -> Iterator[Bench]:
    config = IngestConfig(inbox=5, inbox_per_agent=3, max_cameras_per_agent=2)
    bench = Bench(path, config)
    yield bench
    bench.close()


def test_a_camera_is_asked_for_once(bench: Bench) -> None:
    assert bench.handle(keyframe_question(0)) == [NeedCamera(CAMERA.hash)]
    assert bench.handle(camera_question()) == [Stored()]
    assert bench.handle(keyframe_question(0)) == [Stored()]
    # Another agent with the same camera need not send it.
    assert bench.handle(keyframe_question(0, "a1")) == [Stored()]


def test_a_batch_is_one_commit_and_one_wake_up(bench: Bench) -> None:
    heads: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    listener = bench.hub.join()
    listener.subscribe(keyexprs.LOG_HEAD, lambda _, payload: heads.put(payload))
    bench.handle(camera_question())
    assert bench.handle(*(keyframe_question(seq) for seq in range(3))) == [Stored()] * 3
    assert codec.decode(heads.get(timeout=WAIT_S), LogHead) == LogHead(bench.log.log_id, 3)
    assert bench.handle(keyframe_question(0)) == [Duplicate()]
    bench.handle(keyframe_question(3))
    assert codec.decode(heads.get(timeout=WAIT_S), LogHead).head == 4
    listener.close()


def test_an_agent_that_floods_takes_no_place_of_the_others(bench: Bench) -> None:
    bench.handle(camera_question())
    flood = [keyframe_question(seq) for seq in range(10)]
    for question in flood:
        bench.intake.on_keyframe(question)
    other = [keyframe_question(seq, "a1") for seq in range(3)]
    for question in other:
        bench.intake.on_keyframe(question)
    bench.ingest.handle(bench.inbox.drain(1000))
    busy = RetryAfter(0.5, "too many uploads wait")
    assert [question.answer for question in flood] == [Stored()] * 3 + [busy] * 7
    # Five in all: the places that the first agent may not have.
    assert [question.answer for question in other] == [Stored()] * 2 + [busy]
    # Then there is room again.
    assert bench.handle(keyframe_question(9)) == [Stored()]


def test_large_uploads_are_turned_away_unread(path: Path) -> None:
    bench = Bench(path, IngestConfig(max_upload_bytes=100))
    (answer,) = bench.handle(keyframe_question(0))
    assert isinstance(answer, Rejected)
    assert answer.code == "too_large"
    assert len(bench.inbox) == 0
    assert bench.ingest.status().counters["rejected.too_large"] == 1
    bench.close()


@pytest.mark.parametrize(
    "key",
    [
        "covinz/agent/*/up/keyframe",
        "covinz/agent/a0/**",
        "covinz/agent/a0/up/*",
        "covinz/agent/A0/up/keyframe",
        "covinz/agent/a0/up/camera",
        "covinz/**",
        "covinz/agent",
    ],
)
def test_other_keys_are_rejected(bench: Bench, key: str) -> None:
    question = Question(message(0), key)
    bench.intake.on_keyframe(question)
    assert isinstance(question.answer, Rejected)
    assert question.answer.code == "bad_key"
    assert len(bench.inbox) == 0


def test_cameras_of_an_agent_are_limited(bench: Bench) -> None:
    def camera(focal: float) -> Camera:
        return dataclasses.replace(CAMERA, params=np.array([focal, focal, 300.0, 200.0]))

    assert bench.handle(camera_question(camera=camera(400))) == [Stored()]
    assert bench.handle(camera_question(camera=camera(401))) == [Stored()]
    (answer,) = bench.handle(camera_question(camera=camera(402)))
    assert isinstance(answer, Rejected)
    assert answer.code == "too_many_cameras"
    assert bench.handle(camera_question(camera=camera(401))) == [Duplicate()]
    assert bench.handle(camera_question("a1", camera(402))) == [Stored()]


def test_when_the_disk_fails_nothing_is_acknowledged(bench: Bench, path: Path) -> None:
    bench.handle(camera_question())
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    assert (
        bench.handle(keyframe_question(0), keyframe_question(1))
        == [RetryAfter(2.0, "the server cannot write to its disk")] * 2
    )
    other.execute("ROLLBACK")
    other.close()
    assert bench.handle(keyframe_question(0), keyframe_question(1)) == [Stored()] * 2
    assert bench.ingest.status().counters["failed_commits"] == 1


def test_a_bug_in_admission_stays_with_the_upload_that_met_it(bench: Bench) -> None:
    bench.handle(camera_question())
    broken = keyframe_question(0)
    upload = Upload("a0", False, None, broken)  # type: ignore[arg-type]
    bench.intake.on_keyframe(keyframe_question(1))
    good = keyframe_question(2)
    bench.intake.on_keyframe(good)
    bench.ingest.handle([upload, *bench.inbox.drain(10)])
    assert isinstance(broken.answer, RetryAfter)
    assert good.answer == Stored()


def test_status_counts(bench: Bench, path: Path) -> None:
    bench.handle(camera_question(), camera_question("a1"), keyframe_question(0))
    gap = Question(
        codec.encode(Gap("a0", SESSION, 5, 9, "spool full")), keyexprs.agent_keyframe("a0")
    )
    bench.handle(keyframe_question(0), keyframe_question(0), gap)
    bench.handle(keyframe_question(1, "a1"), Question(b"", keyexprs.agent_keyframe("a1")))
    question = Question(b"", "status")
    bench.ingest.handle([StatusRequest(question)])
    status = codec.decode(question.answers[0], Status)
    assert (status.service, status.instance, status.cursor) == ("ingest", "ingest", 3)
    assert (status.log_id, status.pending, status.dirty) == (bench.log.log_id, 0, False)
    kept = {
        "keyframes": 2,
        "keyframes.a0": 1,
        "keyframes.a1": 1,
        "bytes.a0": len(message(0)) + len(gap.payload),
        "bytes.a1": len(message(1, "a1")),
        "gaps": 1,
        "gaps.a0": 1,
        "dropped_keyframes": 5,
        "dropped_keyframes.a0": 5,
    }
    kept["bytes"] = kept["bytes.a0"] + kept["bytes.a1"]
    passing = {"duplicates": 1, "need_camera": 1, "rejected.malformed": 1}
    kept["entries_without_features"] = 0
    assert status.counters["log_bytes"] > kept["bytes"]
    assert {**status.counters, "log_bytes": 0} == {**kept, **passing, "log_bytes": 0}
    bench.log.close()
    # What is in the log is counted again after a restart.
    again = Bench(path, IngestConfig())
    assert {**again.ingest.status().counters, "log_bytes": 0} == {**kept, "log_bytes": 0}
    again.close()


def test_only_the_first_rejection_of_a_kind_is_a_warning(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(3):
        bench.handle(Question(b"", keyexprs.agent_keyframe("a0")))
    bench.handle(Question(b"", keyexprs.agent_keyframe("a1")))
    warnings = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert len(warnings) == 2
    assert "a0: malformed" in warnings[0]
    assert "a1: malformed" in warnings[1]


def ask(bus: InMemoryBus, question: Question) -> UploadReply:
    (reply,) = bus.ask(question.key, question.payload)
    return codec.decode_upload_reply(reply)


def test_the_whole_service(tmp_path: Path) -> None:
    hub = Hub()
    agent = hub.join()
    with LocalIngest(hub, tmp_path) as ingest:
        log_id = ingest.status().log_id
        assert ask(agent, keyframe_question(0)) == NeedCamera(CAMERA.hash)
        assert ask(agent, camera_question()) == Stored()
        for seq in (2, 0, 1):
            assert ask(agent, keyframe_question(seq)) == Stored()
        assert ingest.asker.ask(keyexprs.keyframe(keyframe(1).id)) == [message(1)]
    with LocalIngest(hub, tmp_path) as ingest:
        assert ask(agent, keyframe_question(1)) == Duplicate()
        assert ask(agent, keyframe_question(3)) == Stored()
        assert ingest.status().log_id == log_id
        items = [entry.item for entry in ingest.entries()]
        assert [item.id.seq for item in items if not isinstance(item, Gap)] == [2, 0, 1, 3]
    agent.close()


def test_many_agents_at_once(tmp_path: Path) -> None:
    hub = Hub()
    with LocalIngest(hub, tmp_path) as ingest:
        assert ask(ingest.asker, camera_question()) == Stored()

        def send_all(agent: str) -> None:
            bus = hub.join()
            for seq in range(20):
                while ask(bus, keyframe_question(seq, agent)) != Stored():
                    pass
            bus.close()

        agents = [f"a{i}" for i in range(4)]
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(send_all, agents))
        entries = ingest.entries()
        assert [entry.log_index for entry in entries] == list(range(80))
        count = Counter(e.item.id.agent for e in entries if not isinstance(e.item, Gap))
        assert count == dict.fromkeys(agents, 20)
