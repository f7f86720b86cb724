from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import pytest

from covinz import codec, keyexprs, log_follower
from covinz.bus import Closable, Query
from covinz.log_follower import LogFollower, LogReset
from covinz.memory_bus import Hub, InMemoryBus
from covinz.types import Gap, LogHead, LogPage, LogRange, LogView

WAIT_S = 20.0
NEVER_S = 600.0
FIRST_LOG, SECOND_LOG = "01J9Z0000000000000000000AA", "01J9Z0000000000000000000BB"
SESSION = "01J9Z0000000000000000000CC"

Delivered = LogReset | LogPage


class Log:
    """A log that grows, goes away and is replaced; answers as ingest does."""

    def __init__(self, bus: InMemoryBus, log_id: str = FIRST_LOG, page_entries: int = 3) -> None:
        self.bus = bus
        self.log_id = log_id
        self.head = 0
        self.views: list[LogView] = []
        self.starts: queue.Queue[int] = queue.Queue()
        self.mangle: Callable[[bytes], bytes] = lambda page: page
        self._page_entries = page_entries
        self._answerer: Closable | None = None

    def come(self) -> None:
        self._answerer = self.bus.answer(keyexprs.LOG_RANGE, self._answer)

    def go(self) -> None:
        assert self._answerer is not None
        self._answerer.close()

    def grow(self, count: int, tell: bool = True) -> None:
        self.head += count
        if tell:
            self.bus.put(keyexprs.LOG_HEAD, codec.encode(LogHead(self.log_id, self.head)))

    def _answer(self, query: Query) -> None:
        asked = codec.decode(query.payload, LogRange)
        self.views.append(asked.view)
        last = min(self.head, asked.start + self._page_entries)
        entries = [(i, codec.encode(gap(i))) for i in range(asked.start, last)]
        page = codec.encode_log_page(self.log_id, self.head, entries)
        query.reply(self.mangle(page))
        self.starts.put(asked.start)


def gap(index: int) -> Gap:
    return Gap("a", SESSION, 2 * index, 2 * index, "test")


class Consumer:
    """Keeps what it is given; fails on a gap or an overlap."""

    def __init__(self, cursor: int = 0) -> None:
        self.cursor = cursor
        self.events: queue.Queue[Delivered] = queue.Queue()

    def __call__(self, event: Delivered) -> None:
        if isinstance(event, LogReset):
            self.cursor = 0
        else:
            for entry in event.entries:
                assert entry.log_index == self.cursor
                assert entry.item == gap(self.cursor)
                self.cursor += 1
        self.events.put(event)

    def reset(self) -> str:
        event = self.events.get(timeout=WAIT_S)
        assert isinstance(event, LogReset)
        return event.log_id

    def page(self) -> list[int]:
        event = self.events.get(timeout=WAIT_S)
        assert isinstance(event, LogPage)
        return [entry.log_index for entry in event.entries]


@pytest.fixture
def hub() -> Hub:
    return Hub()


@pytest.fixture
def log(hub: Hub) -> Iterator[Log]:
    with closing(hub.join()) as bus:
        yield Log(bus)


Follow = Callable[..., None]


@pytest.fixture
def follow(hub: Hub) -> Iterator[Follow]:
    """Follow the log; never looks without a reason unless told so."""
    with ExitStack() as stack:

        def start(
            deliver: Callable[[Delivered], object],
            cursor: int = 0,
            log_id: str = "",
            recheck_s: float = NEVER_S,
            view: LogView = LogView.POSE,
        ) -> None:
            bus = stack.enter_context(closing(hub.join()))
            follower = LogFollower(bus, view, deliver, recheck_s)
            stack.enter_context(closing(follower))
            follower.start(cursor, log_id)

        yield start


def test_a_late_start_reads_the_whole_log_page_by_page(log: Log, follow: Follow) -> None:
    log.grow(7)
    log.come()
    consumer = Consumer()
    follow(consumer, view=LogView.FULL)
    assert consumer.reset() == FIRST_LOG
    assert [consumer.page() for _ in range(3)] == [[0, 1, 2], [3, 4, 5], [6]]
    assert set(log.views) == {LogView.FULL}


def test_an_empty_log_is_known_by_its_id(log: Log, follow: Follow) -> None:
    log.come()
    consumer = Consumer()
    follow(consumer)
    assert consumer.reset() == FIRST_LOG
    log.grow(1)
    assert consumer.page() == [0]


def test_a_restart_goes_on_where_it_was(log: Log, follow: Follow) -> None:
    log.grow(7)
    log.come()
    consumer = Consumer(cursor=5)
    follow(consumer, cursor=5, log_id=FIRST_LOG)
    assert consumer.page() == [5, 6]
    log.grow(1)
    assert consumer.page() == [7]


def test_a_publication_wakes_the_follower(log: Log, follow: Follow) -> None:
    log.come()
    consumer = Consumer()
    follow(consumer)
    consumer.reset()
    for i in range(20):
        log.grow(1)
        assert consumer.page() == [i]


def test_what_comes_soon_after_a_page_comes_with_the_next(
    log: Log, follow: Follow, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_follower, "GATHER_S", 1.0)
    log.come()
    consumer = Consumer()
    follow(consumer)
    consumer.reset()
    log.grow(1)
    consumer.page()
    for _ in range(3):
        log.grow(1)
    assert consumer.page() == [1, 2, 3]


def test_closing_does_not_wait_for_more_to_gather(
    log: Log, follow: Follow, hub: Hub, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_follower, "GATHER_S", NEVER_S)
    log.come()
    with closing(hub.join()) as bus:
        consumer = Consumer()
        follower = LogFollower(bus, LogView.POSE, consumer, NEVER_S)
        follower.start(0, "")
        consumer.reset()
        log.grow(1)  # whoever is at the head gathers what follows
        follower.close(timeout_s=WAIT_S)
    assert not any(t.name == "log-follower" and t.is_alive() for t in threading.enumerate())


def test_lost_publications_are_made_up_for_by_looking(log: Log, follow: Follow) -> None:
    log.come()
    consumer = Consumer()
    follow(consumer, recheck_s=0.01)
    consumer.reset()
    for i in range(3):
        log.grow(1, tell=False)
        assert consumer.page() == [i]


def test_malformed_publications_do_no_harm(log: Log, follow: Follow) -> None:
    log.come()
    consumer = Consumer()
    follow(consumer)
    consumer.reset()
    log.bus.put(keyexprs.LOG_HEAD, b"nonsense")
    log.grow(1)
    assert consumer.page() == [0]


def test_ingest_may_go_away_and_return(log: Log, follow: Follow) -> None:
    log.grow(2)
    log.come()
    consumer = Consumer()
    follow(consumer)
    consumer.reset()
    consumer.page()
    log.go()
    log.grow(1)  # the follower looks, and nobody is there
    log.come()
    assert consumer.page() == [2]


def test_a_follower_may_start_before_ingest(log: Log, follow: Follow) -> None:
    consumer = Consumer()
    follow(consumer)
    log.grow(4)
    log.come()
    assert consumer.reset() == FIRST_LOG
    assert consumer.page() == [0, 1, 2]
    assert consumer.page() == [3]


def test_another_log_makes_the_consumer_start_anew(log: Log, follow: Follow) -> None:
    log.grow(2)
    log.come()
    consumer = Consumer()
    follow(consumer)
    consumer.reset()
    consumer.page()
    log.log_id, log.head = SECOND_LOG, 0
    log.grow(4)
    assert consumer.reset() == SECOND_LOG
    assert consumer.page() == [0, 1, 2]
    assert consumer.page() == [3]


def test_a_log_that_lost_its_tail_makes_the_consumer_start_anew(log: Log, follow: Follow) -> None:
    log.grow(2)
    log.come()
    consumer = Consumer(cursor=9)
    follow(consumer, cursor=9, log_id=FIRST_LOG)
    assert consumer.reset() == FIRST_LOG
    assert consumer.page() == [0, 1]


def test_another_log_is_noticed_at_the_same_head(log: Log, follow: Follow) -> None:
    log.grow(2)
    log.come()
    consumer = Consumer(cursor=2)
    follow(consumer, cursor=2, log_id=SECOND_LOG)
    assert consumer.reset() == FIRST_LOG
    assert consumer.page() == [0, 1]


def test_a_slow_consumer_is_not_asked_ahead_of(log: Log, follow: Follow) -> None:
    log.grow(9)
    log.come()
    consumer = Consumer()
    entered: queue.Queue[None] = queue.Queue()
    go_on: queue.Queue[None] = queue.Queue()

    def slow(event: Delivered) -> None:
        if isinstance(event, LogPage):
            entered.put(None)
            go_on.get(timeout=WAIT_S)
        consumer(event)

    follow(slow)
    consumer.reset()
    asked: list[int] = []
    for _ in range(3):
        entered.get(timeout=WAIT_S)
        while not log.starts.empty():
            asked.append(log.starts.get())
        assert asked[-1] == consumer.cursor  # nothing beyond the page that waits
        go_on.put(None)
        consumer.page()
    assert sorted(set(asked)) == [0, 3, 6]


@pytest.mark.parametrize(
    "wrong",
    [
        b"nonsense",
        codec.encode_log_page(FIRST_LOG, 9, [(1, codec.encode(gap(1)))]),
        codec.encode_log_page(FIRST_LOG, 9, []),
    ],
    ids=["malformed", "other entries", "no entries"],
)
def test_an_unusable_page_is_asked_for_again(log: Log, follow: Follow, wrong: bytes) -> None:
    log.grow(2)
    pages = iter([wrong])
    log.mangle = lambda page: next(pages, page)
    log.come()
    consumer = Consumer()
    follow(consumer, log_id=FIRST_LOG)
    assert consumer.page() == [0, 1]


def test_closing_does_not_wait_for_a_consumer_that_blocks(hub: Hub, log: Log) -> None:
    log.grow(5)
    log.come()
    entered, release = threading.Event(), threading.Event()
    delivered: list[Delivered] = []

    def block(event: Delivered) -> None:
        delivered.append(event)
        entered.set()
        release.wait(WAIT_S)

    with closing(hub.join()) as bus:
        follower = LogFollower(bus, LogView.POSE, block)
        follower.start(0, FIRST_LOG)
        assert entered.wait(WAIT_S)
        follower.close(timeout_s=0.01)
        release.set()
    assert len(delivered) == 1


def test_closing_ends_with_the_question_that_nobody_answers(hub: Hub, log: Log) -> None:
    asked = threading.Event()
    log.bus.answer(keyexprs.LOG_RANGE, lambda _: asked.set())
    consumer = Consumer()
    with closing(hub.join()) as bus:
        follower = LogFollower(bus, LogView.POSE, consumer)
        follower.start(0, "")
        assert asked.wait(WAIT_S)
        bus.close()
        follower.close()
    assert not any(t.name == "log-follower" and t.is_alive() for t in threading.enumerate())
    assert consumer.events.empty()


def test_closing_before_the_start_is_allowed(hub: Hub) -> None:
    with closing(hub.join()) as bus:
        LogFollower(bus, LogView.POSE, Consumer()).close()
