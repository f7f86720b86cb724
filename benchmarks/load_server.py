"""A server as `covinz up` starts it, to measure: what its processes use, and how far it is."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import yaml

from covinz import client
from covinz.bus import ZenohBus
from covinz.config import BusConfig, Config
from covinz.run import free_port
from covinz.supervisor import ProcessSpec, Supervisor, server_specs
from covinz.types import Status

# Whatever a service is asked for happens within this time, or the measurement fails. [s]
PATIENCE_S = 600.0
# Not more often: every answer costs what is measured.
_POLL_S = 0.2
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
_PAGE_MIB = os.sysconf("SC_PAGE_SIZE") / (1 << 20)


@dataclass(frozen=True, slots=True)
class Usage:
    """What a process has used so far: CPU time [s], and the memory that it has now [MiB]."""

    cpu_s: float
    rss_mib: float


class Server:
    """Processes that were started, and a bus to ask them.

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
        return {name: process_usage(of["pid"]) for name, of in pids.items()}

    def status(self, service: str) -> Status:
        """How far a service is; TimeoutError if it does not answer."""
        found: list[Status] = []

        def is_there() -> bool:
            found.extend(client.statuses(self.bus, service))
            return bool(found)

        self.wait(is_there, f"{service} to answer")
        return found[0]

    def jobs_done(self) -> int:
        """Jobs with an outcome."""
        counters = self.status("place_recognition").counters
        names = [name for name in counters if name == "accepted" or name.startswith("rejected.")]
        return int(sum(counters[name] for name in names))

    def wait_workers(self, count: int) -> None:
        """Wait until so many loop solvers answer."""
        workers = f"{count} loop solvers"
        self.wait(lambda: len(client.statuses(self.bus, "loop_solver")) == count, workers)

    def wait_looked_up(self, jobs_done: bool = False) -> None:
        """Wait until place recognition is at the head, and no job is open if that is asked."""

        def is_done() -> bool:
            status = self.status("place_recognition")
            if jobs_done and status.pending + status.leased:
                return False
            return status.cursor == self.status("ingest").cursor

        self.wait(is_done, "the log to be looked up")

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Wait for something that is asked for over and over.

        Raises:
            TimeoutError: If it takes longer than `PATIENCE_S`.
        """
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"waited too long for {what}; see {self.folder / 'logs'}")
            time.sleep(_POLL_S)


@contextmanager
def running_server(folder: Path, workers: int, waiting: int = 0) -> Iterator[Server]:
    """A server with its data in a folder, which may be that of an earlier one.

    Args:
        folder: For data, logs and configuration.
        workers: Loop solvers.
        waiting: Loop solvers that wait instead of solving; see `benchmarks.load_worker`.
    """
    config = Config(bus=BusConfig(endpoint=f"tcp/127.0.0.1:{free_port()}"))
    folder.mkdir(parents=True, exist_ok=True)
    file, data = folder / "config.yaml", folder / "data"
    file.write_text(yaml.safe_dump(config.model_dump(mode="json")))
    specs = server_specs(file.resolve(), data.resolve(), workers)
    specs += [_waiting_worker(number, file.resolve(), data.resolve()) for number in range(waiting)]
    with Supervisor(specs, folder / "logs", folder / "processes.json"):
        bus = ZenohBus.open(config.bus)
        try:
            server = Server(config.bus.endpoint, bus, folder)
            for name in ("ingest", "place_recognition", "optimizer"):
                server.status(name)
            server.wait_workers(workers + waiting)
            yield server
        finally:
            bus.close()


def _waiting_worker(number: int, config: Path, data: Path) -> ProcessSpec:
    name = f"waiting-{number}"
    options = ("--config", str(config), "--data", str(data), "--id", name)
    return ProcessSpec(name, (sys.executable, "-m", "benchmarks.load_worker", *options))


def process_usage(pid: int) -> Usage:
    """Of one process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    cpu_s = (int(fields[11]) + int(fields[12])) * _TICK_S
    return Usage(cpu_s, int(fields[21]) * _PAGE_MIB)


def machine_cpu_s() -> float:
    """CPU time that everything on this machine has used."""
    line = Path("/proc/stat").read_text().splitlines()[0].split()
    user, nice, system, _idle, _iowait, irq, softirq = map(int, line[1:8])
    return (user + nice + system + irq + softirq) * _TICK_S
