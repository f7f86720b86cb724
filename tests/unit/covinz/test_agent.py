"""The agent against the real ingest and against servers that fail, on an in-memory bus."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from covinz import codec, keyexprs
from covinz.agent import Agent
from covinz.bus import BusError, MessageTooLarge, Query
from covinz.config import AgentConfig, Config, IngestConfig
from covinz.memory_bus import Hub, InMemoryBus
from covinz.spool import Spool, SpoolError
from covinz.spool_writer import StampError
from covinz.types import (
    ULID_PATTERN,
    Gap,
    Keyframe,
    KeyframeId,
    NeedCamera,
    Rejected,
    RetryAfter,
    Stored,
    UploadReply,
)
from tests.local_ingest import WAIT_S, LocalIngest
from tests.uploads import CAMERA, OTHER_SESSION, SESSION, content, message

# Pauses so short that a test with failures takes no time.
HASTY = AgentConfig(min_backoff_s=0.001, max_backoff_s=0.01, ack_timeout_s=5.0)
# Pauses so long that a test fails if they are not cut short.
SLOW = AgentConfig(min_backoff_s=600.0, max_backoff_s=600.0)


def agent_on(bus: InMemoryBus, spool: Path, config: AgentConfig = HASTY, **more: object) -> Agent:
    return Agent("a0", bus, spool, Config(agent=config), **more)  # type: ignore[arg-type]


def logged(ingest: LocalIngest) -> list[KeyframeId]:
    items = [entry.item for entry in ingest.entries()]
    return [item.id for item in items if isinstance(item, Keyframe)]


class FaultyBus(InMemoryBus):
    """Loses what `loses` says of the n-th question: nothing, the question, or its answers."""

    def __init__(self, hub: Hub, loses: Callable[[int], str]) -> None:
        super().__init__(hub)
        self._loses = loses
        self._asked_lock = threading.Lock()
        self.num_asked = 0

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        with self._asked_lock:
            lost = self._loses(self.num_asked)
            self.num_asked += 1
        if lost == "question":
            return []
        replies = super().ask(key, payload, timeout_s)
        return [] if lost == "answer" else replies


class ScriptedIngest:
    """Answers every upload as it is told, from a thread of the bus; None leaves it waiting."""

    def __init__(self, hub: Hub, answer: Callable[[bytes], UploadReply | None]) -> None:
        self._answer = answer
        self._changed = threading.Condition()
        self.payloads: list[bytes] = []
        self.waiting: list[Query] = []
        self._bus = hub.join()
        self._bus.answer(keyexprs.AGENT_KEYFRAMES, self._on_upload)
        self._bus.answer(keyexprs.AGENT_CAMERAS, lambda query: query.reply(codec.encode(Stored())))

    def wait_for_uploads(self, count: int) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.payloads) >= count, WAIT_S)

    def close(self) -> None:
        self._bus.close()

    def _on_upload(self, query: Query) -> None:
        answer = self._answer(query.payload)
        with self._changed:
            self.payloads.append(query.payload)
            if answer is None:
                self.waiting.append(query)
            self._changed.notify_all()
        if answer is not None:
            query.reply(codec.encode(answer))


def wait_for_pause(agent: Agent) -> None:
    """Until the agent has read that it is to wait."""
    tick = threading.Event()
    for _ in range(int(WAIT_S / 0.005)):
        if agent._uploader.put_off is not None:
            return
        tick.wait(0.005)
    pytest.fail("the server's answer never arrived")


@pytest.fixture
def hub() -> Hub:
    return Hub()


@pytest.fixture
def bus(hub: Hub) -> Iterator[InMemoryBus]:
    bus = hub.join()
    yield bus
    bus.close()


@pytest.fixture
def spool(tmp_path: Path) -> Path:
    return tmp_path / "a0.spool"


def test_keyframes_reach_the_log_as_they_were_sent(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    with LocalIngest(hub, tmp_path) as ingest, agent_on(bus, spool, session=SESSION) as agent:
        sent = [agent.send(content(seq)) for seq in range(20)]
        assert sent == [KeyframeId("a0", SESSION, seq) for seq in range(20)]
        assert agent.wait_delivered(WAIT_S)
        assert agent.pending == 0
        assert sorted(logged(ingest)) == sent
        for seq in range(20):
            assert bus.ask(keyexprs.keyframe(sent[seq])) == [message(seq)]
        counters = ingest.status().counters
        assert "need_camera" not in counters
        assert "duplicates" not in counters


def test_a_negative_zero_in_a_calibration_is_a_zero(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    # The last row of a transform does not travel: its hash must not depend on the sign there.
    T_body_cam = np.eye(4)
    T_body_cam[3, :3] = -0.0
    camera = dataclasses.replace(CAMERA, T_body_cam=T_body_cam)
    with LocalIngest(hub, tmp_path) as ingest, agent_on(bus, spool) as agent:
        sent = agent.send(content(0, camera=camera))
        assert agent.wait_delivered(WAIT_S)
        assert logged(ingest) == [sent]


@pytest.mark.parametrize("lost", ["question", "answer"])
def test_what_gets_lost_is_sent_again_and_logged_once(
    hub: Hub, spool: Path, tmp_path: Path, lost: str
) -> None:
    bus = FaultyBus(hub, lambda n: lost if n % 3 == 1 else "nothing")
    with LocalIngest(hub, tmp_path) as ingest, agent_on(bus, spool) as agent:
        sent = [agent.send(content(seq)) for seq in range(30)]
        assert agent.wait_delivered(WAIT_S)
        assert sorted(logged(ingest)) == sent
        duplicates = ingest.status().counters.get("duplicates", 0)
        assert (duplicates > 0) == (lost == "answer")
    bus.close()


def test_an_overloaded_server_is_given_time(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    config = IngestConfig(inbox_per_agent=1, retry_after_s=0.001)
    with LocalIngest(hub, tmp_path, config) as ingest, agent_on(bus, spool) as agent:
        sent = [agent.send(content(seq)) for seq in range(40)]
        assert agent.wait_delivered(WAIT_S)
        assert sorted(logged(ingest)) == sent


def test_a_pause_that_the_server_asked_for_is_kept(hub: Hub, bus: InMemoryBus, spool: Path) -> None:
    ingest = ScriptedIngest(hub, lambda _: RetryAfter(60.0, "busy"))
    config = HASTY.model_copy(update={"window": 1})
    with agent_on(bus, spool, config) as agent:
        agent.send(content(0))
        ingest.wait_for_uploads(1)
        agent.send(content(1))
        assert not agent.wait_delivered(0.1)
        assert len(ingest.payloads) == 1
    ingest.close()


def test_a_pause_that_the_server_asked_for_outlives_a_success(
    hub: Hub, bus: InMemoryBus, spool: Path
) -> None:
    first = message(0)
    answers = {first: None}
    ingest = ScriptedIngest(hub, lambda payload: answers.get(payload, RetryAfter(60.0, "busy")))
    config = HASTY.model_copy(update={"window": 2})
    with agent_on(bus, spool, config, session=SESSION) as agent:
        agent.send(content(0))
        ingest.wait_for_uploads(1)
        agent.send(content(1))
        ingest.wait_for_uploads(2)
        wait_for_pause(agent)
        ingest.waiting[0].reply(codec.encode(Stored()))
        agent.send(content(2))
        assert not agent.wait_delivered(0.1)
        assert (len(ingest.payloads), agent.pending) == (2, 2)
    ingest.close()


def test_a_refusal_that_the_disk_cannot_keep_stops_nobody(
    hub: Hub, bus: InMemoryBus, spool: Path
) -> None:
    def answer(payload: bytes) -> UploadReply:
        return Rejected("malformed", "") if payload == message(0) else Stored()

    folder = spool.with_name("a0.spool.rejected")
    folder.write_bytes(b"")  # in its way
    config = HASTY.model_copy(update={"window": 1})
    with agent_on(bus, spool, config, session=SESSION) as agent:
        for seq in range(5):
            agent.send(content(seq))
        ingest = ScriptedIngest(hub, answer)
        ingest.wait_for_uploads(6)
        assert set(ingest.payloads) >= {message(seq) for seq in range(5)}
        folder.unlink()
        assert agent.wait_delivered(WAIT_S)
        assert (agent.report().rejected, len(list(folder.iterdir()))) == (1, 2)
    ingest.close()


def test_a_refused_keyframe_is_reported_once_and_declared_as_a_gap(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    refused: list[tuple[KeyframeId, Rejected]] = []
    big = content(1, num_features=200)
    config = IngestConfig(max_features=100)
    with (
        LocalIngest(hub, tmp_path, config) as ingest,
        agent_on(bus, spool, on_rejected=lambda *args: refused.append(args)) as agent,
    ):
        sent = [agent.send(made) for made in (content(0), big, content(2))]
        assert agent.wait_delivered(WAIT_S)
        assert sorted(logged(ingest)) == [sent[0], sent[2]]
        gaps = [entry.item for entry in ingest.entries() if isinstance(entry.item, Gap)]
        assert gaps == [Gap("a0", agent.session, 1, 1, "rejected: too_many_features")]
        assert ingest.status().counters["rejected.too_many_features"] == 1
    assert [(name, answer.code) for name, answer in refused] == [(sent[1], "too_many_features")]


def test_a_refused_camera_refuses_its_keyframes_only(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    another = dataclasses.replace(CAMERA, params=2 * CAMERA.params)
    refused: list[KeyframeId] = []
    with (
        LocalIngest(hub, tmp_path, IngestConfig(max_cameras_per_agent=1)) as ingest,
        agent_on(bus, spool, on_rejected=lambda name, _: refused.append(name)) as agent,
    ):
        before = agent.send(content(0))
        assert agent.wait_delivered(WAIT_S)
        bad = agent.send(content(1, camera=another))
        after = agent.send(content(2))
        assert agent.wait_delivered(WAIT_S)
        assert logged(ingest) == [before, after]
        assert refused == [bad]


def test_a_server_that_forgot_the_camera_is_told_again(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    with agent_on(bus, spool) as agent:
        with LocalIngest(hub, tmp_path / "old"):
            agent.send(content(0))
            assert agent.wait_delivered(WAIT_S)
        with LocalIngest(hub, tmp_path / "new") as ingest:
            second = agent.send(content(1))
            assert agent.wait_delivered(WAIT_S)
            assert logged(ingest) == [second]
            assert ingest.status().counters["need_camera"] == 1


def test_a_server_that_always_asks_for_the_camera_is_not_asked_in_a_tight_loop(
    hub: Hub, bus: InMemoryBus, spool: Path
) -> None:
    ingest = ScriptedIngest(hub, lambda _: NeedCamera(CAMERA.hash))
    with agent_on(bus, spool, SLOW) as agent:
        agent.send(content(0))
        ingest.wait_for_uploads(2)
        assert not agent.wait_delivered(0.1)
        # Twice an attempt; the news that the server is there may have cut one pause short.
        assert len(ingest.payloads) in (2, 4)
    ingest.close()


def test_an_overflow_is_declared_and_the_rest_delivered(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    config = HASTY.model_copy(update={"max_spool_bytes": 6 * len(message())})
    with agent_on(bus, spool, config) as agent:
        sent = [agent.send(content(seq)) for seq in range(30)]
        with LocalIngest(hub, tmp_path) as ingest:
            assert agent.wait_delivered(WAIT_S)
            kept = {name.seq for name in logged(ingest)}
            items = [entry.item for entry in ingest.entries()]
            gaps = [item for item in items if isinstance(item, Gap)]
    assert sent[-1].seq in kept
    dropped = [seq for gap in gaps for seq in range(gap.first_seq, gap.last_seq + 1)]
    assert len(dropped) > 0
    assert sorted(dropped + list(kept)) == list(range(30))


def test_a_robot_that_restarts_delivers_what_was_left(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    with agent_on(bus, spool) as agent:
        sent = [agent.send(content(seq)) for seq in range(5)]
    with LocalIngest(hub, tmp_path) as ingest, agent_on(bus, spool) as agent:
        assert agent.session != sent[0].session
        sent.append(agent.send(content(5)))
        assert sent[-1].seq == 0
        assert agent.wait_delivered(WAIT_S)
        assert sorted(logged(ingest)) == sorted(sent)


def test_answers_after_the_end_of_a_run_are_of_no_harm(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    silent = ScriptedIngest(hub, lambda _: None)
    agent = agent_on(bus, spool)
    sent = agent.send(content(0))
    silent.wait_for_uploads(1)
    # Not at once: a thread of its own may be reading the spool, which could not be opened again.
    agent.close()
    silent.waiting[0].reply(codec.encode(Stored()))
    silent.close()
    with LocalIngest(hub, tmp_path) as ingest, agent_on(bus, spool) as agent:
        assert agent.wait_delivered(WAIT_S)
        assert logged(ingest) == [sent]


def test_sending_does_not_wait_for_the_server(hub: Hub, bus: InMemoryBus, spool: Path) -> None:
    silent = ScriptedIngest(hub, lambda _: None)
    with agent_on(bus, spool) as agent:
        for seq in range(10):
            agent.send(content(seq))
        assert agent.pending == 10
        silent.wait_for_uploads(HASTY.window)
        assert len(silent.payloads) == HASTY.window
        silent.close()


def test_an_upload_that_never_comes_through_does_not_stop_the_others(
    hub: Hub, bus: InMemoryBus, spool: Path
) -> None:
    poison = message(0)
    ingest = ScriptedIngest(hub, lambda payload: None if payload == poison else Stored())
    config = HASTY.model_copy(update={"window": 1, "ack_timeout_s": 0.02})
    with agent_on(bus, spool, config, session=SESSION) as agent:
        for seq in range(5):
            agent.send(content(seq))
        ingest.wait_for_uploads(8)
        assert set(ingest.payloads) >= {message(seq) for seq in range(1, 5)}
        assert not agent.wait_delivered(0.0)
        assert agent.pending == 1
    ingest.close()


@pytest.mark.parametrize("news", ["server", "keyframe"])
def test_news_end_a_pause(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path, news: str
) -> None:
    faulty = FaultyBus(hub, lambda n: "question" if n < 4 else "nothing")
    config = SLOW.model_copy(update={"window": 1})
    if news == "server":
        with agent_on(bus, spool, config) as agent:
            agent.send(content(0))
            assert not agent.wait_delivered(0.05)
            with LocalIngest(hub, tmp_path):
                assert agent.wait_delivered(WAIT_S)
    else:
        with LocalIngest(hub, tmp_path), agent_on(faulty, spool, config) as agent:
            agent.send(content(0))
            for seq in range(1, 8):
                agent.wait_delivered(0.02)
                agent.send(content(seq))
            assert agent.wait_delivered(WAIT_S)
    faulty.close()


def test_a_new_session_counts_from_zero(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    with LocalIngest(hub, tmp_path) as ingest, agent_on(bus, spool) as agent:
        sent = [agent.send(content(0)), agent.send(content(1))]
        session = agent.new_session()
        assert session == agent.session != sent[0].session
        assert ULID_PATTERN.fullmatch(session)
        sent.append(agent.send(content(2)))
        assert sent[-1] == KeyframeId("a0", session, 0)
        assert agent.wait_delivered(WAIT_S)
        assert sorted(logged(ingest)) == sorted(sent)


def test_a_session_that_goes_on_does_not_reuse_numbers(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    with LocalIngest(hub, tmp_path):
        for seq in range(3):
            with agent_on(bus, spool, session=SESSION) as agent:
                assert agent.send(content(seq)) == KeyframeId("a0", SESSION, seq)
                assert agent.wait_delivered(WAIT_S)


def test_keyframes_of_no_use_are_refused_at_once(bus: InMemoryBus, spool: Path) -> None:
    config = Config(agent=HASTY).model_copy(
        update={"bus": Config().bus.model_copy(update={"max_message_bytes": 5000})}
    )
    bad_pose = np.eye(4)
    bad_pose[0, 3] = np.nan
    with Agent("a0", bus, spool, config) as agent:
        with pytest.raises(ValueError, match="rigid"):
            agent.send(dataclasses.replace(content(0), T_odom_body=bad_pose))
        with pytest.raises(MessageTooLarge, match="at most 5000"):
            agent.send(content(0, num_features=1000))
        with pytest.raises(ValueError, match="stamp_ns"):
            agent.send(dataclasses.replace(content(0), stamp_ns=-1))
        assert agent.pending == 0
        assert agent.send(content(1)).seq == 0
        with pytest.raises(StampError):
            agent.send(content(0))
        agent.new_session()
        assert agent.send(content(0)).seq == 0


def test_an_agent_that_is_closed_takes_nothing_more(bus: InMemoryBus, spool: Path) -> None:
    with agent_on(bus, spool) as agent:
        agent.send(content(0))
    with pytest.raises(SpoolError, match="closed"):
        agent.send(content(1))


def test_what_was_dropped_is_counted(hub: Hub, bus: InMemoryBus, spool: Path) -> None:
    config = HASTY.model_copy(update={"max_spool_bytes": 6 * len(message())})
    with agent_on(bus, spool, config) as agent:
        for seq in range(30):
            agent.send(content(seq))
        report = agent.report()
    assert report.bytes <= 6 * len(message())
    left = Spool(spool, "a0", config)
    rows = []
    while (row := left.take()) is not None:
        rows.append(row)
    left.close()
    assert sum(row.count for row in rows) == 30
    assert report.dropped == sum(row.count for row in rows if row.is_gap) > 20
    assert (report.pending, report.rejected) == (len(rows), 0)


def test_malformed_names(bus: InMemoryBus, spool: Path) -> None:
    with pytest.raises(ValueError, match="agent id"):
        Agent("A 0", bus, spool)
    with pytest.raises(ValueError, match="session"):
        agent_on(bus, spool, session="today")
    with pytest.raises(BusError):
        Agent("a0", "nonsense", spool)
    agent_on(bus, spool, session=OTHER_SESSION).close()  # nobody kept the spool


def test_one_process_per_spool(bus: InMemoryBus, spool: Path) -> None:
    with agent_on(bus, spool), pytest.raises(SpoolError, match="in use"):
        agent_on(bus, spool)


def test_it_is_alive_until_it_is_closed(hub: Hub, bus: InMemoryBus, spool: Path) -> None:
    watcher = hub.join()
    agent = agent_on(bus, spool)
    assert watcher.alive(keyexprs.AGENTS_ALIVE) == ["covinz/agent/a0/alive"]
    agent.close()
    agent.close()
    assert watcher.alive(keyexprs.AGENTS_ALIVE) == []
    watcher.close()


def test_a_mistake_in_a_callback_does_not_end_the_upload(
    hub: Hub, bus: InMemoryBus, spool: Path, tmp_path: Path
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("the robot's mistake")

    config = IngestConfig(max_features=100)
    with (
        LocalIngest(hub, tmp_path, config) as ingest,
        agent_on(bus, spool, on_rejected=fail) as agent,
    ):
        for seq in range(8):
            agent.send(content(seq, num_features=200 if seq % 2 else 3))
        assert agent.wait_delivered(WAIT_S)
        assert sorted(name.seq for name in logged(ingest)) == [0, 2, 4, 6]


def test_importing_covinz_stays_light() -> None:
    check = (
        "import covinz, sys; assert 'zenoh' not in sys.modules;"
        "from covinz import Agent; assert Agent.__module__ == 'covinz.agent'"
    )
    subprocess.run([sys.executable, "-c", check], check=True)
