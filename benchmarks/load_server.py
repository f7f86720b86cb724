"""A server as `covinz up` starts it, for measurements: its processes, what they use, how far it is."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from covinz import client, config
from covinz.bus import ZenohBus
from covinz.run import free_port
from covinz.supervisor import ProcessSpec, Supervisor, server_specs
from covinz.types import Status

# Services that answer before anything is measured: [s]
_START_S = 60.0
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Usage:
    """What a process has used so far: CPU time [s] and the memory that is its own [MiB]."""

    cpu_s: float
    rss_mib: float


class Server:
    """Processes under a supervisor, and a bus to ask them.

    Attributes:
        endpoint: Of the router.
        bus: Of the measurement itself.
        folder: Data, logs, configuration.
    """

    def __init__(self, endpoint: str, bus: ZenohBus, folder: Path) -> None:
        self.endpoint = endpoint
        self.bus = bus
        self.folder = folder

    def usage(self) -> dict[str, Usage]:
        """Of each process by its name."""
        pids = json.loads((self.folder / "processes.json").read_text())
        return {name: _usage(of["pid"]) for name, of in pids.items()}

    def status(self, service: str) -> Status:
        """How far a service is.

        Raises:
            TimeoutError: If it does not answer for long.
        """
        deadline_s = time.monotonic() + _START_S
        while time.monotonic() < deadline_s:
            for status in client.statuses(self.bus, service):
                return status
            time.sleep(0.1)
        raise TimeoutError(f"{service} does not answer; see {self.folder / 'logs'}")

    def wait_workers(self, count: int) -> None:
        """Wait until so many loop solvers answer."""
        deadline_s = time.monotonic() + _START_S
        while len(client.statuses(self.bus, "loop_solver")) < count:
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"no {count} loop solvers; see {self.folder / 'logs'}")
            time.sleep(0.1)


@contextmanager
def running_server(
    folder: Path, workers: int, settings: Mapping[str, Any] | None = None
) -> Iterator[Server]:
    """A server in a folder that is empty, or that an earlier one has left."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    values = config.merge(settings or {}, {"bus": {"endpoint": endpoint}})
    made = config.validate(config.Config, values, "the settings of a benchmark")
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "config.yaml"
    file.write_text(yaml.safe_dump(made.model_dump(mode="json")))
    specs = server_specs(file.resolve(), (folder / "data").resolve(), workers)
    with supervised(folder, specs):
        bus = ZenohBus.open(made.bus)
        try:
            server = Server(endpoint, bus, folder)
            for name in ("ingest", "place_recognition", "optimizer"):
                server.status(name)
            server.wait_workers(workers)
            yield server
        finally:
            bus.close()


def supervised(folder: Path, specs: list[ProcessSpec]) -> Supervisor:
    """Processes that write their logs and pids into a folder."""
    return Supervisor(specs, folder / "logs", folder / "processes.json")


def _usage(pid: int) -> Usage:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    cpu_s = (int(fields[11]) + int(fields[12])) * _TICK_S
    pages = int(fields[21])
    return Usage(cpu_s, pages * os.sysconf("SC_PAGE_SIZE") / (1 << 20))
