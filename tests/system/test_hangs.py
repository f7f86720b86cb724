"""Processes that hang: stopped from outside, stuck in Python or native code, or at their end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
import yaml

from covinz import client
from covinz.bus import ZenohBus
from covinz.config import BusConfig
from covinz.supervisor import SILENT_S, Supervisor, server_specs
from covinz.watch import FAILED, STUCK

WAIT_S = 60.0
StartProgram = Callable[..., subprocess.Popen[str]]

# The main loop gets stuck in what is given after the options.
PROGRAM = """
import sys
way = sys.argv.pop()
from covinz.service import serve

def run(context):
    context.inbox.put(None)
    context.inbox.take(None)
    context.inbox.take(0.0)
    if way == "python":
        while True:
            pass
    if way == "native":  # an expression that takes for ever and does not let other threads run
        import re
        re.match(r"(a*)*b", "a" * 60)
    if way == "thread":
        import threading
        threading.Thread(target=lambda: 1 / 0, name="helper").start()
        context.inbox.take(None)
    with context.watch.work("a job", 1.0):
        import threading
        threading.Event().wait()

serve("example", run)
"""


@pytest.mark.parametrize(
    ("way", "code", "said"),
    [
        ("python", STUCK, "stuck: the main loop takes"),
        ("job", STUCK, "stuck: a job takes"),
        ("native", 1, "Timeout"),
        ("thread", FAILED, "helper failed: ZeroDivisionError"),
    ],
)
def test_a_process_that_is_stuck_or_lacks_a_thread_ends_itself_and_says_where(
    tmp_path: Path,
    bus_config: BusConfig,
    config_file: Path,
    start_program: StartProgram,
    way: str,
    code: int,
    said: str,
) -> None:
    hang_s = 600.0 if way in ("job", "thread") else 2.0
    settings = {"bus": bus_config.model_dump(mode="json"), "health": {"hang_s": hang_s}}
    config_file.write_text(yaml.safe_dump(settings))
    options = ["--config", str(config_file), "--data", str(tmp_path / "data")]
    process = start_program("example", [sys.executable, "-c", PROGRAM, *options, way])
    assert process.wait(WAIT_S) == code
    log = (tmp_path / "example.log").read_text()
    assert said in log
    assert 'File "<string>", line' in log  # where it was


class Server:
    """A whole server under the supervisor."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        self.folder = folder
        config_file = folder / "config.yaml"
        config_file.write_text(yaml.safe_dump({"bus": {"endpoint": endpoint}}))
        specs = server_specs(config_file, folder / "data", workers=1)
        self.names = [spec.name for spec in specs]
        self.supervisor = Supervisor(specs, folder / "logs", folder / "processes.json")

    def pid(self, name: str) -> int:
        return int(json.loads((self.folder / "processes.json").read_text())[name]["pid"])

    def wait_started(self, name: str, starts: int) -> None:
        deadline, tick = time.monotonic() + WAIT_S, threading.Event()
        while self.supervisor.starts().get(name, 0) < starts:
            assert time.monotonic() < deadline, f"{name} was not started again"
            tick.wait(0.05)


@pytest.fixture
def server(tmp_path: Path, free_endpoint: str) -> Iterator[Server]:
    made = Server(tmp_path, free_endpoint)
    with made.supervisor:
        yield made


@pytest.mark.slow
def test_whatever_hangs_is_started_again_and_nothing_else(
    server: Server, free_endpoint: str, tmp_path: Path
) -> None:
    names = server.names
    with closing(ZenohBus.open(BusConfig(endpoint=free_endpoint))) as bus:
        client.wait_idle(bus, WAIT_S)
        for name in names:
            server.wait_started(name, 1)
        for name in names:
            os.kill(server.pid(name), signal.SIGSTOP)
        for name in names:
            server.wait_started(name, 2)
        client.wait_idle(bus, WAIT_S)
        # The one that all others hang on, alone: nobody else is blamed.
        os.kill(server.pid("router"), signal.SIGSTOP)
        server.wait_started("router", 3)
        client.wait_idle(bus, WAIT_S)
    others = {name: 2 for name in names if name != "router"}
    assert server.supervisor.starts() == {**others, "router": 3}
    assert SILENT_S < 15


def test_a_service_whose_router_vanished_ends_when_told(
    tmp_path: Path, config_file: Path, start_service: StartProgram
) -> None:
    """Stopped, not killed: the connection is there, but nobody answers the goodbye."""
    router = start_service("router")
    ingest = start_service("ingest")
    log = tmp_path / "ingest.log"
    tick = threading.Event()
    while not log.exists() or "ready" not in log.read_text():
        assert ingest.poll() is None
        tick.wait(0.05)
    router.send_signal(signal.SIGSTOP)
    try:
        ingest.terminate()
        assert ingest.wait(WAIT_S) == 0
        assert "stopped" in log.read_text()
    finally:
        router.kill()
