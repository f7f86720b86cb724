"""Real server processes on a free loopback port, for system tests."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from types import TracebackType

from covinz import codec, keyexprs
from covinz.bus import ZenohBus
from covinz.config import BusConfig
from covinz.types import LogEntry, LogPage, LogRange, LogView, Status

CHECKOUT = Path(__file__).resolve().parent.parent
# Longer than anything here takes on a busy machine. [s]
PATIENCE_S = 60.0


def free_endpoint() -> str:
    """An endpoint on the loopback interface that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class Processes:
    """Services that can be started, killed and started again; all end with the block.

    Args:
        folder: Their data (below ``data``) and logs.

    Attributes:
        endpoint: Of the router.
        bus: A bus of the test itself.
    """

    def __init__(self, folder: Path) -> None:
        self.endpoint = free_endpoint()
        self.data = folder / "data"
        self.bus = ZenohBus.open(BusConfig(endpoint=self.endpoint), wait_s=0.0)
        self._folder = folder
        self._spawned: list[subprocess.Popen[bytes]] = []
        self._started: dict[str, subprocess.Popen[bytes]] = {}
        self._changed = threading.Condition()
        self._alive: set[str] = set()
        self.bus.watch_alive(keyexprs.SERVICES_ALIVE, self._on_token)

    def __enter__(self) -> Processes:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.bus.close()
        for child in self._spawned:
            child.kill()
            child.wait()

    def start(self, *names: str) -> None:
        """Start services and wait until they are ready."""
        for name in names:
            self._started[name] = self.spawn(name)
        for name in names:
            self._wait(name, there=True)

    def spawn(self, name: str) -> subprocess.Popen[bytes]:
        """Start a service without waiting for it; its log is in ``<folder>/<name>.log``."""
        environment = dict(os.environ, COVINZ__BUS__ENDPOINT=self.endpoint)
        with (self._folder / f"{name}.log").open("ab") as log:
            child = subprocess.Popen(
                [sys.executable, "-m", f"services.{name}", "--data", str(self.data)],
                cwd=CHECKOUT,
                env=environment,
                stderr=log,
            )
        self._spawned.append(child)
        return child

    def kill(self, name: str) -> None:
        """End a service like a power cut does, and wait until everybody has noticed."""
        self._started[name].kill()
        self._started[name].wait()
        self._wait(name, there=False)

    def pid(self, name: str) -> int:
        """The process that was started last under a name; fails when it has ended."""
        assert self._started[name].poll() is None, self.log_of(name)
        return self._started[name].pid

    def freeze(self, name: str) -> None:
        """Let a service hang: nothing of it runs until `thaw`, and its connections stay open."""
        self._started[name].send_signal(signal.SIGSTOP)

    def thaw(self, name: str) -> None:
        """Let it go on."""
        self._started[name].send_signal(signal.SIGCONT)

    def wait_ready(self, name: str) -> None:
        """Wait until a service that runs can be reached (again)."""
        self._wait(name, there=True)

    def stop(self, name: str) -> int:
        """Ask a service to end; returns its exit code."""
        self._started[name].terminate()
        return self._started[name].wait()

    def log_of(self, name: str) -> str:
        """What a service has written to its log."""
        return (self._folder / f"{name}.log").read_text()

    def status(self, name: str) -> Status:
        """How far a service is."""
        (reply,) = self.bus.ask(keyexprs.service_status(name, "*"))
        return codec.decode(reply, Status)

    def log_entries(self, view: LogView = LogView.POSE) -> list[LogEntry]:
        """The whole keyframe log."""
        entries: list[LogEntry] = []
        while True:
            question = codec.encode(LogRange(len(entries), view))
            (reply,) = self.bus.ask(keyexprs.LOG_RANGE, question)
            page = codec.decode(reply, LogPage)
            entries += page.entries
            if len(entries) == page.head:
                return entries

    def _on_token(self, key: str, alive: bool) -> None:
        name, _ = keyexprs.service_of(key)
        with self._changed:
            (self._alive.add if alive else self._alive.discard)(name)
            self._changed.notify_all()

    def _wait(self, name: str, there: bool) -> None:
        with self._changed:
            if not self._changed.wait_for(lambda: (name in self._alive) == there, PATIENCE_S):
                state = "up" if there else "down"
                raise AssertionError(f"{name} is not {state}:\n{self.log_of(name)}")
