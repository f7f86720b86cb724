"""The server under test: `covinz up` as its user starts it, and what can be seen from outside."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

from covinz import client, config
from covinz.access import enrolment
from covinz.access.credentials import SUFFIX, with_credentials, write_secret
from covinz.access.enrolment import Request
from covinz.access.roster import FOLDER, Roster
from covinz.bus import Bus, ZenohBus
from covinz.config import BusConfig
from covinz.run import free_port
from covinz.supervisor import child_environment, die_with_parent

CHECKOUT = Path(__file__).resolve().parents[2]
# A server that does not come up at all on a busy machine. [s]
START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 30.0
# Between two looks at who answers, and how long one takes. [s]
_LOOK_S = 0.05
_ANSWER_S = 1.0


class Server:
    """One `covinz up` in a folder, stopped with the block.

    Args:
        folder: For its configuration and log.
        data: For its files.
        settings: Of the scenario.
        workers: Loop solvers.
        host: Address where robots connect by credentials; None: this machine without any.
        transport: ``tls`` or ``quic``; counts with `host`.
    """

    def __init__(
        self,
        folder: Path,
        data: Path,
        settings: Mapping[str, Any],
        workers: int,
        host: str | None = None,
        transport: str = "tls",
    ) -> None:
        self._folder = folder
        self._data = data
        self._host = host
        self._transport = transport
        self._settings = settings
        self._port = free_port()
        self._endpoint = f"tcp/127.0.0.1:{self._port}"
        self.config_file = data / "config.yaml"
        self.instances = {
            *("router", "ingest", "place_recognition", "optimizer"),
            *(f"loop_solver-{i}" for i in range(workers)),
        }
        self._workers = workers
        self._process: subprocess.Popen[bytes] | None = None
        self.bus: Bus

    def enrol(self, agents: Iterable[str]) -> None:
        """Let robots in, where they come with credentials."""
        if self._host is None:
            return
        roster = Roster(self._data / FOLDER)
        for name in agents:
            wanted = Request(name, "agent", self._host, self._port, self._transport)
            write_secret(self._folder / f"{name}{SUFFIX}", enrolment.add(roster, wanted).text())

    def way(self, agent: str) -> str:
        """How a robot is told to reach the server."""
        if self._host is None:
            return self._endpoint
        return str(self._folder / f"{agent}{SUFFIX}")

    def __enter__(self) -> Server:
        written = self._folder / "config.yaml"
        endpoint = {} if self._host else {"bus": {"endpoint": self._endpoint}}
        written.write_text(yaml.safe_dump(config.merge(self._settings, endpoint)))
        argv = [sys.executable, "-m", "covinz.cli", "up", "--config", str(written)]
        argv += ["--data", str(self._data), "--workers", str(self._workers)]
        argv += ["--listen", self._host] if self._host else []
        with (self._folder / "server.log").open("ab") as log:
            self._process = subprocess.Popen(
                argv,
                cwd=CHECKOUT,
                env=child_environment(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                preexec_fn=die_with_parent,
            )
        try:
            own = BusConfig(endpoint=self._endpoint)
            if self._host:
                own = with_credentials(BusConfig(), Roster(self._data / FOLDER).server_credentials)
            self.bus = ZenohBus.open(own, wait_s=0.0)
            deadline = time.monotonic() + START_TIMEOUT_S
            if self.wait_ready(deadline) is None:
                raise RuntimeError(f"the server did not come up; see {self._folder}/server.log")
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.bus.close()
        self._stop()

    def pids(self, names: Iterable[str]) -> Mapping[str, int]:
        """Process ids by name, as the server itself writes them down."""
        running = json.loads((self._data / "processes.json").read_text())
        return {name: running[name]["pid"] for name in names}

    def starts(self) -> int:
        """How often processes were started."""
        running = json.loads((self._data / "processes.json").read_text())
        return sum(process["starts"] for process in running.values())

    def signal(self, names: Sequence[str], number: signal.Signals) -> float:
        """Send a signal to processes, all at once; returns when [monotonic s]."""
        for pid in self.pids(names).values():
            os.kill(pid, number)
        return time.monotonic()

    def wait_at_work(self, names: Sequence[str], timeout_s: float) -> None:
        """Wait until a loop solver of `names`, if there is one among them, has a job."""
        deadline = time.monotonic() + timeout_s
        while any(name.startswith("loop_solver") for name in names):
            found = client.statuses(self.bus, "loop_solver", timeout_s=_ANSWER_S)
            busy = any(status.leased for status in found if status.instance in names)
            if busy or time.monotonic() > deadline:
                return

    def wait_ready(self, deadline_s: float) -> float | None:
        """When every process answers for itself [monotonic s]; None when time ran out first."""
        missing = self.instances
        pause = threading.Event()
        while missing:
            if time.monotonic() > deadline_s:
                return None
            found = client.statuses(self.bus, timeout_s=_ANSWER_S)
            missing = self.instances - {status.instance for status in found}
            pause.wait(_LOOK_S if missing else 0.0)
        return time.monotonic()

    def _stop(self) -> None:
        if self._process is None:
            return
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
