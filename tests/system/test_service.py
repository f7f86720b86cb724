"""The service shell as a process: signals, exit codes, arguments, one thread for numbers."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from covinz import keyexprs
from covinz.bus import ZenohBus
from covinz.niceness import LONG_TURNS_S, SHORT_TURNS_S
from tests.turns import turn_s

WAIT_S = 20.0
CHECKOUT = Path(__file__).resolve().parents[2]

# Ends by itself when told over the bus; otherwise it works until it is stopped.
PROGRAM = """
import os
import services
assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
from covinz.service import serve

def run(context):
    assert context.data_dir.is_dir()
    context.bus.answer("covinz/fail", lambda query: context.inbox.put(query))
    while True:
        event = context.inbox.take(None)
        if type(event).__name__ == "StatusRequest":
            event.query.reply(b"")
        else:
            raise ZeroDivisionError("told to fail")

serve("example", run)
"""

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start_example(
    tmp_path: Path, config_file: Path, start_program: Callable[..., subprocess.Popen[str]]
) -> Start:
    def start(*extra: str) -> subprocess.Popen[str]:
        arguments = ["--config", str(config_file), "--data", str(tmp_path / "new" / "data")]
        return start_program("example", [sys.executable, "-c", PROGRAM, *arguments, *extra])

    return start


def wait_alive(bus: ZenohBus, service: str, instance: str) -> None:
    alive = threading.Event()
    watch = bus.watch_alive(keyexprs.service_alive(service, instance), lambda *_: alive.set())
    assert alive.wait(WAIT_S)
    watch.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_service_cleanly(
    start_service: Start,
    start_example: Start,
    open_bus: Callable[[], ZenohBus],
    tmp_path: Path,
    number: signal.Signals,
) -> None:
    start_service("router")
    process = start_example("--id", "example-2")
    wait_alive(open_bus(), "example", "example-2")
    process.send_signal(number)
    assert process.wait(WAIT_S) == 0
    lines = (tmp_path / "example.log").read_text().splitlines()
    assert any("INFO    example-2 covinz.service: ready" in line for line in lines)
    assert not any("Traceback" in line for line in lines)


def threads(pid: int) -> dict[int, str]:
    """Names of a process's threads by their ids."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return {int(task.name): (task / "comm").read_text().strip() for task in tasks}


def test_what_comes_in_passes_through_one_thread_of_zenoh(
    start_service: Start, open_bus: Callable[[], ZenohBus]
) -> None:
    start_service("router")
    solver = start_service("loop_solver")
    bus = open_bus()
    wait_alive(bus, "loop_solver", "loop_solver")
    kinds = {name.split("-")[0] for name in threads(solver.pid).values()}
    assert {"rx", "tx"} <= kinds and not kinds & {"acc", "app", "net"}


def test_only_what_computes_for_long_takes_long_turns(
    start_service: Start, open_bus: Callable[[], ZenohBus]
) -> None:
    # Robots and workers wait for all other threads, those of the same process among them.
    start_service("router")
    names = ("loop_solver", "optimizer", "place_recognition", "ingest")
    processes = {name: start_service(name) for name in names}
    bus = open_bus()
    for name in names:
        wait_alive(bus, name, name)

    def all_turns(name: str) -> list[float]:
        return sorted(turn_s(thread) for thread in threads(processes[name].pid))

    tick = threading.Event()
    for name, num_long in (*((name, 0) for name in names[2:]), *((name, 1) for name in names[:2])):
        for _ in range(int(WAIT_S / 0.02)):
            turns = all_turns(name)
            if turns[-1] > SHORT_TURNS_S or not num_long:
                break
            tick.wait(0.02)  # its thread may not have begun
        expected = [SHORT_TURNS_S] * (len(turns) - num_long) + [LONG_TURNS_S] * num_long
        assert turns == pytest.approx(expected), name


def test_every_line_of_a_json_log_is_an_object(start_example: Start, tmp_path: Path) -> None:
    process = start_example("--log-format", "json")
    log, tick = tmp_path / "example.log", threading.Event()
    while '"ready"' not in log.read_text():
        assert process.poll() is None
        tick.wait(0.02)
    process.terminate()
    assert process.wait(WAIT_S) == 0
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert {line["service"] for line in lines} == {"example"}
    messages = [line["message"] for line in lines]
    assert messages[0] == "ready" and messages[-1] == "stopped"


def test_a_signal_ends_a_service_that_has_no_router(
    start_example: Start, free_endpoint: str, tmp_path: Path
) -> None:
    host, port = free_endpoint.removeprefix("tcp/").split(":")
    with socket.create_server((host, int(port))) as no_router:
        process = start_example()
        for _ in range(2):  # it tries, and tries again
            connection, _ = no_router.accept()
            connection.close()
        process.terminate()
        assert process.wait(WAIT_S) == 0
    assert "Traceback" not in (tmp_path / "example.log").read_text()


def test_a_service_that_fails_exits_with_an_error(
    start_service: Start,
    start_example: Start,
    open_bus: Callable[[], ZenohBus],
    tmp_path: Path,
) -> None:
    start_service("router")
    process = start_example()
    bus = open_bus()
    wait_alive(bus, "example", "example")
    assert bus.ask("covinz/fail", timeout_s=WAIT_S) == []  # its end drops the query
    assert process.wait(WAIT_S) == 1
    assert "told to fail" in (tmp_path / "example.log").read_text()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("bus: {endpoint: 7}", "endpoint"),
        ("buss: {}", "buss"),
        ("bus: {endpoint: x}", "not an endpoint: 'x'"),
    ],
)
def test_an_unusable_configuration_is_said_and_final(
    start_example: Start, config_file: Path, tmp_path: Path, content: str, message: str
) -> None:
    config_file.write_text(content)
    assert start_example().wait(WAIT_S) == 2
    log = (tmp_path / "example.log").read_text()
    assert message in log and "Traceback" not in log
