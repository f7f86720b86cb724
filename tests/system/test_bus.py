"""The bus over a real router: delivery, late answers, liveliness, and a router that goes away."""

from __future__ import annotations

import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from covinz import codec, keyexprs
from covinz.bus import BusClosed, BusError, MessageTooLarge, Query, ZenohBus, open_router
from covinz.config import BusConfig
from covinz.types import LogHead, Status

WAIT_S = 20.0
LOG_ID = "01J9Z0000000000000000000AA"
OpenBus = Callable[[], ZenohBus]
StartService = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def router(start_service: StartService) -> subprocess.Popen[str]:
    return start_service("router")


def connected(bus: ZenohBus) -> ZenohBus:
    assert bus.wait_connected(WAIT_S)
    return bus


def wait_answered(bus: ZenohBus, key: str) -> None:
    there = threading.Event()
    watch = bus.watch_answered(key, lambda is_there: there.set() if is_there else there.clear())
    assert there.wait(WAIT_S)
    watch.close()


def append(suffix: bytes) -> Callable[[Query], None]:
    return lambda query: query.reply(query.payload + suffix)


@pytest.mark.usefixtures("router")
def test_publications_arrive_in_order(open_bus: OpenBus) -> None:
    publisher, subscriber = open_bus(), connected(open_bus())
    received: queue.Queue[tuple[str, bytes]] = queue.Queue()
    subscriber.subscribe("covinz/log/*", lambda key, payload: received.put((key, payload)))
    subscriber.answer("covinz/here", lambda query: query.reply(b""))
    wait_answered(publisher, "covinz/here")
    for i in range(100):
        publisher.put("covinz/log/head", bytes([i]))
    assert [received.get(timeout=WAIT_S) for _ in range(100)] == [
        ("covinz/log/head", bytes([i])) for i in range(100)
    ]


@pytest.mark.usefixtures("router")
def test_everybody_who_answers_is_heard(open_bus: OpenBus) -> None:
    asker, first, second = open_bus(), open_bus(), open_bus()
    for name, bus in (("a", first), ("b", second)):
        bus.answer(keyexprs.service_status("solver", name), append(name.encode()))
        wait_answered(asker, keyexprs.service_status("solver", name))
    assert sorted(asker.ask(keyexprs.service_status("solver", "*"), b"hello ")) == [
        b"hello a",
        b"hello b",
    ]
    assert asker.ask(keyexprs.service_status("solver", "a")) == [b"a"]


@pytest.mark.usefixtures("router")
def test_a_held_query_is_answered_later_from_another_thread(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    held: queue.Queue[Query] = queue.Queue()
    server.answer(keyexprs.JOB_LEASE, held.put)
    wait_answered(asker, keyexprs.JOB_LEASE)
    answers: queue.Queue[list[bytes]] = queue.Queue()
    ask = threading.Thread(target=lambda: answers.put(asker.ask(keyexprs.JOB_LEASE, b"me", 10.0)))
    ask.start()
    query = held.get(timeout=WAIT_S)
    assert query.key == keyexprs.JOB_LEASE and query.payload == b"me"
    assert answers.empty()
    query.reply(b"a job")
    query.drop()
    assert answers.get(timeout=WAIT_S) == [b"a job"]
    ask.join()


@pytest.mark.usefixtures("router")
def test_a_dropped_query_ends_at_once(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    server.answer("covinz/drop", lambda query: query.drop())
    wait_answered(asker, "covinz/drop")
    began = time.monotonic()
    assert asker.ask("covinz/drop", timeout_s=60.0) == []
    assert time.monotonic() - began < 30.0


@pytest.mark.usefixtures("router")
def test_nobody_there_is_an_empty_answer_at_once(open_bus: OpenBus) -> None:
    began = time.monotonic()
    assert connected(open_bus()).ask("covinz/nobody", timeout_s=60.0) == []
    assert time.monotonic() - began < 30.0


@pytest.mark.usefixtures("router")
def test_an_unanswered_query_ends_when_its_time_is_up(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    held: list[Query] = []
    server.answer("covinz/never", held.append)
    wait_answered(asker, "covinz/never")
    assert asker.ask("covinz/never", timeout_s=0.2) == []
    held[0].reply(b"too late")  # must not raise: the asker is gone, which is no fault of ours


@pytest.mark.usefixtures("router")
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
    assert asker.ask("covinz/fail", b"fail", timeout_s=60.0) == []
    assert "asked for" in caplog.text
    assert asker.ask("covinz/fail", b"again") == [b"fine"]


@pytest.mark.usefixtures("router")
@pytest.mark.parametrize("end", [ZenohBus.close, ZenohBus.interrupt])
def test_a_wait_ends_when_the_bus_does(open_bus: OpenBus, end: Callable[[ZenohBus], None]) -> None:
    asker, server = open_bus(), open_bus()
    held: queue.Queue[Query] = queue.Queue()
    server.answer("covinz/never", held.put)
    wait_answered(asker, "covinz/never")
    outcome: queue.Queue[BaseException] = queue.Queue()

    def ask() -> None:
        try:
            asker.ask("covinz/never", timeout_s=600.0)
        except BusClosed as error:
            outcome.put(error)

    thread = threading.Thread(target=ask)
    thread.start()
    held.get(timeout=WAIT_S)
    end(asker)
    assert isinstance(outcome.get(timeout=WAIT_S), BusClosed)
    thread.join()
    with pytest.raises(BusClosed):
        asker.ask("covinz/never")


@pytest.mark.usefixtures("router")
def test_closing_the_bus_drops_its_open_queries(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    held: queue.Queue[Query] = queue.Queue()
    server.answer("covinz/never", held.put)
    wait_answered(asker, "covinz/never")
    answers: queue.Queue[list[bytes]] = queue.Queue()
    thread = threading.Thread(target=lambda: answers.put(asker.ask("covinz/never", b"", 600.0)))
    thread.start()
    query = held.get(timeout=WAIT_S)
    server.close()
    assert answers.get(timeout=WAIT_S) == []
    query.reply(b"too late")
    thread.join()


@pytest.mark.usefixtures("router")
def test_a_message_that_is_too_large_is_refused_and_harms_nobody(open_bus: OpenBus) -> None:
    asker, server = open_bus(), open_bus()
    largest = b"x" * BusConfig().max_message_bytes
    server.answer("covinz/length", lambda query: query.reply(str(len(query.payload)).encode()))
    server.answer("covinz/grow", lambda query: query.reply(largest + b"x"))
    wait_answered(asker, "covinz/length")
    wait_answered(asker, "covinz/grow")
    assert asker.ask("covinz/length", largest) == [str(len(largest)).encode()]
    with pytest.raises(MessageTooLarge):
        asker.put("covinz/length", largest + b"x")
    with pytest.raises(MessageTooLarge):
        asker.ask("covinz/length", largest + b"x")
    assert asker.ask("covinz/grow", timeout_s=60.0) == []
    assert asker.ask("covinz/length", b"still there") == [b"11"]


@pytest.mark.usefixtures("router")
def test_the_router_drops_what_a_foreign_client_sends_beyond_the_limit(
    open_bus: OpenBus, free_endpoint: str
) -> None:
    subscriber = connected(open_bus())
    received: queue.Queue[int] = queue.Queue()
    subscriber.subscribe("covinz/foreign", lambda _, payload: received.put(len(payload)))
    subscriber.answer("covinz/here", lambda query: query.reply(b""))
    wait_answered(subscriber, "covinz/here")
    settings = zenoh.Config()
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", f'["{free_endpoint}"]')
    limit = BusConfig().max_message_bytes
    with zenoh.open(settings) as foreign:
        for size in (limit + 1_000_000, limit + 6000, limit, 5):
            foreign.put(
                "covinz/foreign", b"x" * size, congestion_control=zenoh.CongestionControl.BLOCK
            )
        assert received.get(timeout=WAIT_S) == limit
        assert received.get(timeout=WAIT_S) == 5


@pytest.mark.usefixtures("router")
def test_the_encoding_names_the_schema(open_bus: OpenBus, free_endpoint: str) -> None:
    settings = zenoh.Config()
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", f'["{free_endpoint}"]')
    bus = connected(open_bus())
    with zenoh.open(settings) as foreign:
        received: queue.Queue[str] = queue.Queue()
        foreign.declare_subscriber("covinz/log/head", lambda s: received.put(str(s.encoding)))
        foreign.declare_queryable("covinz/here", lambda _: None)
        wait_answered(bus, "covinz/here")
        bus.put("covinz/log/head", codec.encode(LogHead(LOG_ID, 3)))
        assert received.get(timeout=WAIT_S) == "application/octet-stream;covinz.LogHead/1"


HOLD_TOKEN = """
import signal, sys
from covinz.bus import ZenohBus
from covinz.config import BusConfig
bus = ZenohBus.open(BusConfig(endpoint=sys.argv[1]))
bus.declare_alive("covinz/agent/a/alive")
signal.pause()
"""


@pytest.mark.usefixtures("router")
def test_a_token_vanishes_with_its_process(open_bus: OpenBus, free_endpoint: str) -> None:
    watcher = open_bus()
    changes: queue.Queue[tuple[str, bool]] = queue.Queue()
    watcher.watch_alive(keyexprs.AGENTS_ALIVE, lambda key, alive: changes.put((key, alive)))
    holder = subprocess.Popen([sys.executable, "-c", HOLD_TOKEN, free_endpoint])
    try:
        assert changes.get(timeout=WAIT_S) == ("covinz/agent/a/alive", True)
        assert watcher.alive(keyexprs.AGENTS_ALIVE) == ["covinz/agent/a/alive"]
        late: queue.Queue[tuple[str, bool]] = queue.Queue()
        open_bus().watch_alive("covinz/agent/a/alive", lambda key, alive: late.put((key, alive)))
        assert late.get(timeout=WAIT_S) == ("covinz/agent/a/alive", True)
    finally:
        holder.kill()
        holder.wait()
    assert changes.get(timeout=WAIT_S) == ("covinz/agent/a/alive", False)
    assert watcher.alive(keyexprs.AGENTS_ALIVE) == []


def test_everything_recovers_when_the_router_does(
    open_bus: OpenBus, router: subprocess.Popen[str], start_service: StartService
) -> None:
    asker, server = open_bus(), open_bus()
    changes: queue.Queue[bool] = queue.Queue()
    alive: queue.Queue[bool] = queue.Queue()
    heard: queue.Queue[bytes] = queue.Queue()
    server.answer("covinz/echo", lambda query: query.reply(query.payload))
    server.declare_alive("covinz/agent/a/alive")
    server.subscribe("covinz/view/x", lambda _, payload: heard.put(payload))
    asker.watch_alive(keyexprs.AGENTS_ALIVE, lambda _, is_alive: alive.put(is_alive))
    asker.watch_answered("covinz/echo", changes.put)
    assert changes.get(timeout=WAIT_S) and alive.get(timeout=WAIT_S)
    router.kill()
    router.wait()
    assert not changes.get(timeout=WAIT_S) and not alive.get(timeout=WAIT_S)
    assert asker.ask("covinz/echo", b"anybody?", timeout_s=60.0) == []
    asker.put("covinz/view/x", b"lost")
    start_service("router", "second")
    assert changes.get(timeout=WAIT_S) and alive.get(timeout=WAIT_S)
    assert asker.ask("covinz/echo", b"there") == [b"there"]
    asker.put("covinz/view/x", b"heard")
    assert heard.get(timeout=WAIT_S) == b"heard"


def test_the_bus_opens_and_closes_without_a_router(open_bus: OpenBus) -> None:
    bus = open_bus()
    token = bus.declare_alive("covinz/agent/a/alive")
    bus.put("covinz/view/x", b"lost")
    assert bus.ask("covinz/echo") == [] and bus.alive("**") == []
    assert not bus.wait_connected(0.0)
    token.close()
    token.close()
    bus.close()
    bus.close()
    with pytest.raises(BusClosed):
        bus.ask("covinz/echo")
    with pytest.raises(BusClosed):
        bus.subscribe("covinz/view/x", lambda *_: None)
    bus.put("covinz/view/x", b"a late publication is lost, not an error")


def test_what_was_declared_before_the_router_came_is_there_with_it(
    open_bus: OpenBus, start_service: StartService
) -> None:
    asker, server = open_bus(), open_bus()
    closed = server.answer("covinz/echo", lambda query: query.reply(b"withdrawn"))
    closed.close()
    server.answer("covinz/echo", lambda query: query.reply(query.payload))
    start_service("router")
    wait_answered(asker, "covinz/echo")
    assert asker.ask("covinz/echo", b"there") == [b"there"]


def test_malformed_endpoints_and_keys_are_refused(open_bus: OpenBus) -> None:
    with pytest.raises(BusError, match="nonsense"):
        ZenohBus.open(BusConfig(endpoint="nonsense"))
    with pytest.raises(BusError, match="nonsense"):
        open_router(BusConfig(endpoint="nonsense"))
    with pytest.raises(ValueError, match="not a key expression"):
        open_bus().subscribe("covinz//x", lambda *_: None)


def test_a_second_router_says_that_the_port_is_taken(
    router: subprocess.Popen[str],
    open_bus: OpenBus,
    start_service: StartService,
    tmp_path: Path,
    free_endpoint: str,
) -> None:
    connected(open_bus())
    second = start_service("router", "second")
    assert second.wait(WAIT_S) == 1
    log = (tmp_path / "second.log").read_text()
    assert f"cannot listen on {free_endpoint}" in log
    assert "Traceback" not in log
    assert router.poll() is None


def test_the_router_tells_its_status_and_stops_when_told(
    router: subprocess.Popen[str], open_bus: OpenBus, tmp_path: Path
) -> None:
    bus = open_bus()
    alive = threading.Event()
    bus.watch_alive(keyexprs.service_alive("router", "router"), lambda _, is_there: alive.set())
    assert alive.wait(WAIT_S)
    reply = bus.ask(keyexprs.service_status("router", "router"))
    assert [codec.decode(payload, Status).service for payload in reply] == ["router"]
    router.send_signal(signal.SIGTERM)
    assert router.wait(WAIT_S) == 0
    assert "Traceback" not in (tmp_path / "router.log").read_text()
