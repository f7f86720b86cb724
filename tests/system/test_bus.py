"""The bus between processes: death, a router that goes away, limits against foreign clients."""

from __future__ import annotations

import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from covinz import codec, keyexprs
from covinz.bus import ZenohBus
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
        late: queue.Queue[tuple[str, bool]] = queue.Queue()
        open_bus().watch_alive("covinz/agent/a/alive", lambda key, alive: late.put((key, alive)))
        assert late.get(timeout=WAIT_S) == ("covinz/agent/a/alive", True)
    finally:
        holder.kill()
        holder.wait()
    assert changes.get(timeout=WAIT_S) == ("covinz/agent/a/alive", False)


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


NEVER_CLOSED = """
import sys
from covinz.bus import ZenohBus
from covinz.config import BusConfig
bus = ZenohBus.open(BusConfig(endpoint=sys.argv[1]))
assert bus.wait_connected(20.0)
bus.subscribe("covinz/view/x", lambda *_: None)
bus.answer("covinz/echo", lambda query: query.reply(query.payload))
bus.watch_alive("covinz/**", lambda *_: None)
bus.declare_alive("covinz/agent/a/alive")
assert bus.ask("covinz/echo", b"me") == [b"me"]
"""


@pytest.mark.usefixtures("router")
def test_a_program_that_forgets_to_close_the_bus_ends_all_the_same(free_endpoint: str) -> None:
    program = [sys.executable, "-c", NEVER_CLOSED, free_endpoint]
    assert subprocess.run(program, timeout=2 * WAIT_S, check=False).returncode == 0
