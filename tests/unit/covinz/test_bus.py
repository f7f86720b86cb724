"""What `Bus` promises, held by the real bus over a router in this process and by its double."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from covinz.bus import (
    Bus,
    BusClosed,
    BusError,
    Closable,
    MessageTooLarge,
    Query,
    ZenohBus,
    open_router,
)
from covinz.config import BusConfig
from covinz.memory_bus import Hub, intersects

WAIT_S = 20.0
MAX_BYTES = BusConfig().max_message_bytes
OpenBus = Callable[[], Bus]


@pytest.fixture(params=["zenoh", "memory"])
def open_bus(request: pytest.FixtureRequest, bus_config: BusConfig) -> Iterator[OpenBus]:
    """Opens members of one bus."""
    with ExitStack() as stack:
        hub = Hub()
        if request.param == "zenoh":
            stack.enter_context(closing(open_router(bus_config)))

        def open_() -> Bus:
            bus = ZenohBus.open(bus_config) if request.param == "zenoh" else hub.join()
            return stack.enter_context(closing(bus))

        yield open_


def wait_answered(bus: Bus, key: str) -> None:
    there = threading.Event()
    watch = bus.watch_answered(key, lambda is_there: there.set() if is_there else there.clear())
    assert there.wait(WAIT_S)
    watch.close()


def ask_aside(bus: Bus, key: str) -> queue.Queue[list[bytes] | BusClosed]:
    """Ask from a thread that has all the time in the world."""
    outcome: queue.Queue[list[bytes] | BusClosed] = queue.Queue()

    def ask() -> None:
        try:
            outcome.put(bus.ask(key, b"aside", timeout_s=600.0))
        except BusClosed as error:
            outcome.put(error)

    threading.Thread(target=ask, daemon=True).start()
    return outcome


def append(suffix: bytes) -> Callable[[Query], None]:
    return lambda query: query.reply(query.payload + suffix)


def test_publications_arrive_in_order(open_bus: OpenBus) -> None:
    publisher, subscriber = open_bus(), open_bus()
    received: queue.Queue[tuple[str, bytes]] = queue.Queue()
    subscriber.subscribe("covinz/view/*", lambda key, payload: received.put((key, payload)))
    subscriber.answer("covinz/here", append(b""))
    wait_answered(publisher, "covinz/here")
    publisher.put("covinz/other", b"not for us")
    for i in range(100):
        publisher.put("covinz/view/x", bytes([i]))
    assert [received.get(timeout=WAIT_S) for _ in range(100)] == [
        ("covinz/view/x", bytes([i])) for i in range(100)
    ]


def test_a_member_hears_itself(open_bus: OpenBus) -> None:
    bus = open_bus()
    received: queue.Queue[bytes] = queue.Queue()
    bus.subscribe("covinz/view/x", lambda _, payload: received.put(payload))
    bus.answer("covinz/echo", append(b"!"))
    bus.put("covinz/view/x", b"me")
    assert received.get(timeout=WAIT_S) == b"me"
    assert bus.ask("covinz/echo", b"me") == [b"me!"]


def test_a_closed_subscription_hears_nothing(open_bus: OpenBus) -> None:
    bus = open_bus()
    closed: queue.Queue[bytes] = queue.Queue()
    received: queue.Queue[bytes] = queue.Queue()
    subscription = bus.subscribe("covinz/view/x", lambda _, payload: closed.put(payload))
    bus.subscribe("covinz/view/x", lambda _, payload: received.put(payload))
    subscription.close()
    subscription.close()
    bus.put("covinz/view/x", b"late")
    assert received.get(timeout=WAIT_S) == b"late"
    assert closed.empty()


def test_everybody_who_answers_is_heard(open_bus: OpenBus) -> None:
    asker = open_bus()
    for name in ("a", "b"):
        open_bus().answer(f"covinz/service/x/{name}/status", append(name.encode()))
        wait_answered(asker, f"covinz/service/x/{name}/status")
    assert sorted(asker.ask("covinz/service/*/*/status", b"hello ")) == [b"hello a", b"hello b"]
    assert asker.ask("covinz/service/x/a/status") == [b"a"]


def test_an_answerer_of_many_keys_sees_which_was_asked(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    server.answer("covinz/keyframe/*/*/*", lambda query: query.reply(query.key.encode()))
    wait_answered(asker, "covinz/keyframe/a/s/1")
    assert asker.ask("covinz/keyframe/a/s/1") == [b"covinz/keyframe/a/s/1"]


def test_a_held_query_is_answered_later_from_another_thread(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    held: queue.Queue[Query] = queue.Queue()
    server.answer("covinz/job/lease", held.put)
    wait_answered(asker, "covinz/job/lease")
    answers = ask_aside(asker, "covinz/job/lease")
    query = held.get(timeout=WAIT_S)
    assert (query.key, query.payload) == ("covinz/job/lease", b"aside")
    assert answers.empty()
    query.reply(b"a job")
    query.drop()
    query.reply(b"nobody hears a second reply")
    assert answers.get(timeout=WAIT_S) == [b"a job"]


def test_a_dropped_query_ends_at_once(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    server.answer("covinz/drop", lambda query: query.drop())
    wait_answered(asker, "covinz/drop")
    began = time.monotonic()
    assert asker.ask("covinz/drop", timeout_s=600.0) == []
    assert time.monotonic() - began < 300.0


def test_nobody_there_is_an_empty_answer_at_once(open_bus: OpenBus) -> None:
    began = time.monotonic()
    assert open_bus().ask("covinz/nobody", timeout_s=600.0) == []
    assert time.monotonic() - began < 300.0


def test_an_unanswered_query_ends_when_its_time_is_up(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    held: queue.Queue[Query] = queue.Queue()
    server.answer("covinz/never", held.put)
    server.answer("covinz/never/but", append(b"one"))
    wait_answered(asker, "covinz/never")
    wait_answered(asker, "covinz/never/but")
    assert asker.ask("covinz/**", timeout_s=1.0) == [b"one"]
    held.get(timeout=WAIT_S).reply(b"too late")  # no error: it is not our fault


def test_a_failing_callback_is_logged_and_drops_its_query(
    open_bus: OpenBus, caplog: pytest.LogCaptureFixture
) -> None:
    asker, server = open_bus(), open_bus()

    def fail_once(query: Query) -> None:
        if query.payload == b"fail":
            raise ZeroDivisionError("asked for")
        query.reply(b"fine")

    server.answer("covinz/fail", fail_once)
    wait_answered(asker, "covinz/fail")
    assert asker.ask("covinz/fail", b"fail", timeout_s=600.0) == []
    assert asker.ask("covinz/fail", b"again") == [b"fine"]
    assert "asked for" in caplog.text


@pytest.mark.parametrize("how", ["close", "interrupt"])
def test_a_wait_ends_when_the_bus_does(open_bus: OpenBus, how: str) -> None:
    asker, server = open_bus(), open_bus()
    held: queue.Queue[Query] = queue.Queue()
    server.answer("covinz/never", held.put)
    wait_answered(asker, "covinz/never")
    outcome = ask_aside(asker, "covinz/never")
    query = held.get(timeout=WAIT_S)
    asker.close() if how == "close" else asker.interrupt()
    assert isinstance(outcome.get(timeout=WAIT_S), BusClosed)
    query.drop()
    with pytest.raises(BusClosed):
        asker.ask("covinz/never")


def test_an_interrupted_bus_still_publishes_and_answers(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    server.answer("covinz/echo", append(b"!"))
    wait_answered(asker, "covinz/echo")
    server.interrupt()
    assert asker.ask("covinz/echo", b"there") == [b"there!"]


def test_closing_the_bus_drops_its_open_queries(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    held: queue.Queue[Query] = queue.Queue()
    server.answer("covinz/never", held.put)
    wait_answered(asker, "covinz/never")
    answers = ask_aside(asker, "covinz/never")
    query = held.get(timeout=WAIT_S)
    server.close()
    assert answers.get(timeout=WAIT_S) == []
    query.reply(b"too late")
    assert asker.ask("covinz/never", timeout_s=600.0) == []


def test_a_closed_bus_takes_no_declarations_and_forgets_publications(open_bus: OpenBus) -> None:
    bus = open_bus()
    token = bus.declare_alive("covinz/agent/a/alive")
    bus.close()
    bus.close()
    token.close()
    bus.put("covinz/view/x", b"lost")
    with pytest.raises(BusClosed):
        bus.subscribe("covinz/view/x", lambda *_: None)


def test_a_message_that_is_too_large_is_refused_and_harms_nobody(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    largest = bytes(MAX_BYTES)
    server.answer("covinz/length", lambda query: query.reply(str(len(query.payload)).encode()))
    server.answer("covinz/grow", lambda query: query.reply(largest + b"x"))
    wait_answered(asker, "covinz/length")
    wait_answered(asker, "covinz/grow")
    assert asker.ask("covinz/length", largest) == [str(len(largest)).encode()]
    with pytest.raises(MessageTooLarge):
        asker.put("covinz/length", largest + b"x")
    with pytest.raises(MessageTooLarge):
        asker.ask("covinz/length", largest + b"x")
    assert asker.ask("covinz/grow", timeout_s=600.0) == []
    assert asker.ask("covinz/length", b"still there") == [b"11"]


def test_a_second_watcher_of_one_bus_sees_what_is_there(open_bus: OpenBus) -> None:
    watcher, holder = open_bus(), open_bus()
    first: queue.Queue[tuple[str, bool]] = queue.Queue()
    second: queue.Queue[tuple[str, bool]] = queue.Queue()
    watcher.watch_alive("covinz/agent/*/alive", lambda key, alive: first.put((key, alive)))
    holder.declare_alive("covinz/agent/a/alive")
    assert first.get(timeout=WAIT_S) == ("covinz/agent/a/alive", True)
    watcher.watch_alive("covinz/agent/a/alive", lambda key, alive: second.put((key, alive)))
    assert second.get(timeout=WAIT_S) == ("covinz/agent/a/alive", True)


def test_tokens_are_seen_to_be_there_to_appear_and_to_vanish(open_bus: OpenBus) -> None:
    # Each watcher on a bus of its own: Zenoh tells all watchers of a session what is there when one
    # more begins, and that answer may overtake the end of a token.
    watcher, late_watcher, holder = open_bus(), open_bus(), open_bus()
    changes: queue.Queue[tuple[str, bool]] = queue.Queue()
    watcher.watch_alive("covinz/agent/*/alive", lambda key, alive: changes.put((key, alive)))
    token = holder.declare_alive("covinz/agent/a/alive")
    assert changes.get(timeout=WAIT_S) == ("covinz/agent/a/alive", True)
    holder.declare_alive("covinz/agent/b/alive")
    assert changes.get(timeout=WAIT_S) == ("covinz/agent/b/alive", True)
    late: queue.Queue[tuple[str, bool]] = queue.Queue()
    late_watcher.watch_alive("covinz/agent/a/alive", lambda key, alive: late.put((key, alive)))
    assert late.get(timeout=WAIT_S) == ("covinz/agent/a/alive", True)
    token.close()
    assert changes.get(timeout=WAIT_S) == ("covinz/agent/a/alive", False)
    holder.close()
    assert changes.get(timeout=WAIT_S) == ("covinz/agent/b/alive", False)


def test_a_sender_learns_when_somebody_answers_and_when_nobody_does(open_bus: OpenBus) -> None:
    sender, server = open_bus(), open_bus()
    changes: queue.Queue[bool] = queue.Queue()
    sender.watch_answered("covinz/agent/a/up/keyframe", changes.put)
    answerer = server.answer("covinz/agent/*/up/keyframe", append(b""))
    assert changes.get(timeout=WAIT_S) is True
    answerer.close()
    assert changes.get(timeout=WAIT_S) is False
    server.answer("covinz/agent/*/up/keyframe", append(b""))
    assert changes.get(timeout=WAIT_S) is True
    already: queue.Queue[bool] = queue.Queue()
    sender.watch_answered("covinz/agent/a/up/keyframe", already.put)
    assert already.get(timeout=WAIT_S) is True


@pytest.mark.parametrize("key", ["", "/a", "a/", "a//b"])
def test_a_malformed_key_is_refused(open_bus: OpenBus, key: str) -> None:
    with pytest.raises(ValueError, match="not a key expression"):
        open_bus().subscribe(key, lambda *_: None)


def test_a_malformed_endpoint_is_refused() -> None:
    with pytest.raises(BusError, match="nonsense"):
        ZenohBus.open(BusConfig(endpoint="nonsense"))
    with pytest.raises(BusError, match="nonsense"):
        open_router(BusConfig(endpoint="nonsense"))


def test_an_occupied_endpoint_is_refused(bus_config: BusConfig) -> None:
    with (
        closing(open_router(bus_config)),
        pytest.raises(BusError, match=f"cannot listen on {bus_config.endpoint}"),
    ):
        open_router(bus_config)


def test_without_a_router_the_bus_opens_loses_and_closes(bus_config: BusConfig) -> None:
    bus = ZenohBus.open(bus_config, wait_s=0.0)
    token = bus.declare_alive("covinz/agent/a/alive")
    bus.put("covinz/view/x", b"lost")
    assert bus.ask("covinz/echo") == []
    assert not bus.wait_connected(0.0)
    token.close()
    bus.close()


def test_what_was_declared_before_the_router_came_is_there_with_it(bus_config: BusConfig) -> None:
    with ExitStack() as stack:
        asker = stack.enter_context(closing(ZenohBus.open(bus_config, wait_s=0.0)))
        server = stack.enter_context(closing(ZenohBus.open(bus_config, wait_s=0.0)))
        server.answer("covinz/echo", append(b" and withdrawn")).close()
        server.answer("covinz/echo", append(b"!"))
        stack.enter_context(closing(open_router(bus_config)))
        wait_answered(asker, "covinz/echo")
        assert asker.ask("covinz/echo", b"there") == [b"there!"]


keys = st.lists(st.sampled_from(["a", "b", "*", "**"]), min_size=1, max_size=6).map("/".join)


@given(keys, keys)
def test_key_expressions_match_as_zenoh_says(a: str, b: str) -> None:
    expected = zenoh.KeyExpr.autocanonize(a).intersects(zenoh.KeyExpr.autocanonize(b))
    assert intersects(a, b) == intersects(b, a) == expected


def test_threads_end_with_what_they_were_for(bus_config: BusConfig) -> None:
    def threads_of_buses(kind: str = "") -> list[threading.Thread]:
        return [t for t in threading.enumerate() if t.name.startswith(f"bus-{kind}")]

    assert threads_of_buses() == []
    with closing(open_router(bus_config)), closing(ZenohBus.open(bus_config)) as bus:
        declared: list[Closable] = [
            bus.subscribe("covinz/a", lambda *_: None),
            bus.answer("covinz/a", append(b"")),
            bus.watch_alive("covinz/a", lambda *_: None),
            bus.watch_answered("covinz/a", lambda _: None),
        ]
        threads = threads_of_buses("callback")
        assert len(threads) == len(declared)
        for each in declared:
            each.close()
        for thread in threads:
            thread.join(WAIT_S)
        bus.subscribe("covinz/a", lambda *_: None)
        threads = threads_of_buses("callback")
        assert len(threads) == 1
    threads[0].join(WAIT_S)
    assert threads_of_buses() == []
