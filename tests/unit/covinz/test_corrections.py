"""Which corrections reach a robot."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from covinz import codec, frames, keyexprs
from covinz.corrections import CorrectionFeed, supersedes
from covinz.memory_bus import Hub, InMemoryBus
from covinz.types import Correction, KeyframeId
from tests.uploads import OTHER_SESSION, SESSION

WAIT_S = 20.0
MAP = SESSION
OTHER_MAP = OTHER_SESSION


def correction(
    revision: int,
    stamp_ns: int | None = None,
    map_id: str = MAP,
    agent: str = "a0",
    session: str = SESSION,
) -> Correction:
    T_map_odom = frames.transform(np.eye(3), [revision, 0.0, 0.0])
    stamp_ns = 1000 * revision if stamp_ns is None else stamp_ns
    keyframe = KeyframeId(agent, session, 7)
    return Correction(keyframe, map_id, revision, T_map_odom, False, stamp_ns)


@pytest.mark.parametrize(
    ("new", "is_news"),
    [
        (correction(6), True),
        (correction(5), False),
        (correction(4), False),
        # The clock of the server was set back: of one map the revision still counts.
        (correction(6, stamp_ns=10), True),
        (correction(9, stamp_ns=4000, map_id=OTHER_MAP), False),
        (correction(1, stamp_ns=6000, map_id=OTHER_MAP), True),
        # The server rebuilt its maps.
        (correction(1, stamp_ns=6000), True),
    ],
)
def test_news(new: Correction, is_news: bool) -> None:
    assert supersedes(new, correction(5)) == is_news
    assert supersedes(new, None)


class Robot:
    """Notes what its callback is told."""

    def __init__(self, bus: InMemoryBus) -> None:
        self._changed = threading.Condition()
        self.revisions: list[int] = []
        self.threads: set[int] = set()
        self.feed = CorrectionFeed(bus, "a0", SESSION, self._on_correction)

    def wait_for(self, revisions: list[int]) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: self.revisions == revisions, WAIT_S), (
                self.revisions
            )

    def _on_correction(self, news: Correction) -> None:
        with self._changed:
            self.revisions.append(news.map_revision)
            self.threads.add(threading.get_ident())
            self._changed.notify_all()
        if news.map_revision == 13:
            raise RuntimeError("the robot's mistake")


@pytest.fixture
def hub() -> Hub:
    return Hub()


@pytest.fixture
def server(hub: Hub) -> Iterator[InMemoryBus]:
    bus = hub.join()
    yield bus
    bus.close()


@pytest.fixture
def robot(hub: Hub) -> Iterator[Robot]:
    bus = hub.join()
    robot = Robot(bus)
    yield robot
    robot.feed.close(1.0)
    bus.close()


def publish(server: InMemoryBus, news: Correction | bytes) -> None:
    payload = news if isinstance(news, bytes) else codec.encode(news)
    server.put(keyexprs.agent_correction("a0"), payload)


def test_only_news_of_the_own_session_arrive(server: InMemoryBus, robot: Robot) -> None:
    assert robot.feed.latest is None
    publish(server, correction(2))
    robot.wait_for([2])
    publish(server, b"nonsense")
    publish(server, correction(1))
    publish(server, correction(3, session=OTHER_SESSION))
    publish(server, correction(3, agent="a1"))
    publish(server, correction(4))
    robot.wait_for([2, 4])
    latest = robot.feed.latest
    assert latest is not None
    assert latest.T_map_odom[0, 3] == 4.0


def test_the_latest_is_asked_for_at_the_start_and_on_demand(hub: Hub, server: InMemoryBus) -> None:
    revision = [5]
    server.answer(
        keyexprs.AGENT_CORRECTIONS,
        lambda query: query.reply(codec.encode(correction(revision[0]))),
    )
    bus = hub.join()
    robot = Robot(bus)
    robot.wait_for([5])
    revision[0] = 6
    robot.feed.refresh()
    robot.wait_for([5, 6])
    robot.feed.close(1.0)
    bus.close()


def test_callbacks_come_from_one_thread_and_may_fail(server: InMemoryBus, robot: Robot) -> None:
    for number, revision in enumerate((12, 13, 14), start=1):
        publish(server, correction(revision))
        robot.wait_for([12, 13, 14][:number])
    assert len(robot.threads) == 1
    assert threading.get_ident() not in robot.threads


def test_a_new_session_forgets(server: InMemoryBus, robot: Robot) -> None:
    publish(server, correction(2))
    robot.wait_for([2])
    robot.feed.new_session(OTHER_SESSION)
    assert robot.feed.latest is None
    publish(server, correction(9))
    publish(server, correction(1, session=OTHER_SESSION))
    robot.wait_for([2, 1])


def test_while_a_callback_runs_only_the_latest_waits(hub: Hub, server: InMemoryBus) -> None:
    running, go_on = threading.Event(), threading.Event()
    seen: list[int] = []
    last = threading.Event()

    def slow(news: Correction) -> None:
        seen.append(news.map_revision)
        running.set()
        assert go_on.wait(WAIT_S)
        if news.map_revision == 5:
            last.set()

    bus = hub.join()
    feed = CorrectionFeed(bus, "a0", SESSION, slow)
    publish(server, correction(1))
    assert running.wait(WAIT_S)
    for revision in (2, 3, 4, 5):
        publish(server, correction(revision))
    publish(server, b"nonsense")
    # The bus calls in order: once it has called this, it has delivered all of the above.
    there = threading.Event()
    bus.watch_alive("covinz/service/*/*/alive", lambda *_: there.set())
    server.declare_alive("covinz/service/x/x/alive")
    assert there.wait(WAIT_S)
    go_on.set()
    assert last.wait(WAIT_S)
    assert seen == [1, 5]
    feed.close(1.0)
    bus.close()


def test_a_new_session_waits_for_a_callback_of_the_old_one(hub: Hub, server: InMemoryBus) -> None:
    running, go_on = threading.Event(), threading.Event()
    order: list[str] = []

    def slow(_: Correction) -> None:
        feed.finish_call()  # from inside there is no wait
        running.set()
        assert go_on.wait(WAIT_S)
        order.append("callback")

    def start_anew() -> None:
        feed.new_session(OTHER_SESSION)
        waiting.set()
        feed.finish_call()
        order.append("new session")

    bus, waiting = hub.join(), threading.Event()
    feed = CorrectionFeed(bus, "a0", SESSION, slow)
    publish(server, correction(1))
    assert running.wait(WAIT_S)
    robot = threading.Thread(target=start_anew)
    robot.start()
    assert waiting.wait(WAIT_S)
    go_on.set()
    robot.join(WAIT_S)
    assert order == ["callback", "new session"]
    feed.close(1.0)
    bus.close()


def test_the_callback_may_close_the_feed(hub: Hub, server: InMemoryBus) -> None:
    closed = threading.Event()
    bus = hub.join()
    feeds: list[CorrectionFeed] = []

    def close(_: Correction) -> None:
        feeds[0].close(1.0)
        closed.set()

    feeds.append(CorrectionFeed(bus, "a0", SESSION, close))
    publish(server, correction(1))
    assert closed.wait(WAIT_S)
    bus.close()
