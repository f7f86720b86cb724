"""The server's processes as children of one command: started, restarted when they die, stopped.

Each child has one thread that waits for its end. A child that ends without being asked is started
again, at once if it had been up for a while and with growing pauses if not, so that no crash needs
a human. One more thread listens to the children's heartbeats and kills whose heart has stopped.
Children die with the command even if that is killed (Linux).
"""

from __future__ import annotations

import ctypes
import json
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

from covinz.beats import VARIABLE, BeatListener, Hearts
from covinz.config import ENVIRONMENT_PREFIX

log = logging.getLogger(__name__)

PR_SET_PDEATHSIG = 1
STABLE_AFTER_S = 5.0
MIN_PAUSE_S = 0.1
MAX_PAUSE_S = 5.0
STOP_GRACE_S = 10.0
# A child whose heart has not beaten for so long does not run: it beats every second. [s]
SILENT_S = 8.0
# Heartbeats are waited for so long before those that are missing are looked for. [s]
LOOK_S = 0.5

_libc = ctypes.CDLL(None) if sys.platform.startswith("linux") else None


class ServicesNotFound(RuntimeError):
    """The server's services are not here: covinz was installed without a checkout or image."""


@dataclass(frozen=True)
class ProcessSpec:
    """One process to keep running.

    Attributes:
        name: Unique in the supervisor.
        argv: Command line.
        beats: It sends heartbeats, and is killed when they stop.
        processor: The only one that it runs on; None: wherever it is put.
    """

    name: str
    argv: tuple[str, ...]
    beats: bool = False
    processor: int | None = None


def server_specs(config_file: Path, data: Path, workers: int) -> list[ProcessSpec]:
    """The server: router, ingest, place_recognition, optimizer and `workers` loop solvers.

    Raises:
        ServicesNotFound: If this covinz was installed without them.
    """
    require_services()
    names = ["router", "ingest", "place_recognition", "optimizer"]
    instances: list[tuple[str, str, int | None]] = [(name, name, None) for name in names]
    instances += [
        ("loop_solver", f"loop_solver-{number}", processor)
        for number, processor in enumerate(processors_of(workers))
    ]
    return [
        ProcessSpec(
            instance,
            (
                *(sys.executable, "-m", f"services.{service}"),
                *("--config", str(config_file), "--data", str(data), "--id", instance),
                *("--port-offset", str(number)),
            ),
            beats=True,
            processor=processor,
        )
        for number, (service, instance, processor) in enumerate(instances)
    ]


def processors_of(workers: int) -> list[int | None]:
    """Where each of so many loop solvers runs; None: wherever it is put.

    Solvers that fill the machine get a processor each. Left to the scheduler, what one of them
    wakes while it waits for an answer runs on another one's processor, while its own is idle.

    Source: decision 0036.
    """
    ours = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    fills = workers > 1 and workers == len(ours)
    return [*ours] if fills else [None] * workers


def require_services() -> None:
    """Raise ServicesNotFound if this covinz was installed without the server's services."""
    if not (checkout() / "services").is_dir():
        raise ServicesNotFound(
            "the server's services were not found: run covinz from a checkout (or the image); "
            "a pip-installed covinz is for robots"
        )


def checkout() -> Path:
    """Folder that holds the package `services`, where children are started."""
    return Path(__file__).resolve().parent.parent


def child_environment(environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Environment of a child: one thread for linear algebra, unbuffered output.

    Settings in the environment are in the configuration file that the child is given, and must
    not replace what was decided after them, e.g. the port of a run.
    """
    env = {k: v for k, v in environ.items() if not k.startswith(ENVIRONMENT_PREFIX)}
    env.pop(VARIABLE, None)
    env["PYTHONUNBUFFERED"] = "1"
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        env.setdefault(name, "1")
    paths = [str(checkout()), *filter(None, [env.get("PYTHONPATH")])]
    env["PYTHONPATH"] = os.pathsep.join(paths)
    return env


class Supervisor:
    """Keeps processes running until `stop`.

    Args:
        specs: What to run.
        logs: Folder for one log file a process; None lets them write to this process's stderr.
        pid_file: JSON file kept up to date with the pid and the number of starts of each process.
        grace_s: A process that has not ended this long after SIGTERM is killed.
        silent_s: A process that sends heartbeats is killed this long after the last one.
    """

    def __init__(
        self,
        specs: Sequence[ProcessSpec],
        logs: Path | None = None,
        pid_file: Path | None = None,
        grace_s: float = STOP_GRACE_S,
        silent_s: float = SILENT_S,
    ) -> None:
        self._specs = list(specs)
        self._grace_s = grace_s
        self._hearts = Hearts(silent_s)
        self._logs = logs
        self._pid_file = pid_file
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._starts: dict[str, int] = {}
        self._threads: list[threading.Thread] = []

    def start(self) -> None:
        """Start every process."""
        self._listener = BeatListener()
        self._hearing = threading.Thread(target=self._hear, name="heartbeats")
        if self._listener.hears:
            self._hearing.start()
        for spec in self._specs:
            thread = threading.Thread(
                target=self._keep_running, args=(spec,), name=f"supervise-{spec.name}"
            )
            thread.start()
            self._threads.append(thread)

    def stop(self) -> None:
        """Ask every process to end, kill what has not ended in time, and wait."""
        self._stopping.set()
        with self._lock:
            children = list(self._children.values())
        for child in children:
            child.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + self._grace_s
        for child in children:
            try:
                child.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                log.warning("process %d ignored SIGTERM, killing it", child.pid)
                child.kill()
        for thread in self._threads:
            thread.join()
        if self._listener.hears:
            self._hearing.join()
        self._listener.close()

    def starts(self) -> Mapping[str, int]:
        """How often each process was started."""
        with self._lock:
            return dict(self._starts)

    def __enter__(self) -> Supervisor:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _keep_running(self, spec: ProcessSpec) -> None:
        pause = MIN_PAUSE_S
        while True:
            began = time.monotonic()
            try:
                child = self._spawn(spec)
            except OSError as error:  # no memory, no processes left: that may pass
                log.error("cannot start %s, trying again: %s", spec.name, error)
            else:
                if child is None:
                    return
                code = child.wait()
                with self._lock:
                    self._hearts.died(child.pid)
                if self._stopping.is_set():
                    return
                log.warning("%s ended with %d, starting it again", spec.name, code)
            if time.monotonic() - began > STABLE_AFTER_S:
                pause = MIN_PAUSE_S
            if self._stopping.wait(pause):
                return
            pause = min(2 * pause, MAX_PAUSE_S)

    def _spawn(self, spec: ProcessSpec) -> subprocess.Popen[bytes] | None:
        output = self._open_log(spec)
        try:
            # Under the lock, so that stop() either sees the child or prevents it.
            with self._lock:
                if self._stopping.is_set():
                    return None
                child = subprocess.Popen(
                    spec.argv,
                    cwd=checkout(),
                    env={**child_environment(), **self._listener.environment},
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT if output else None,
                    # Ctrl-C reaches this command only; it then asks its children in order. Not a
                    # session: who gives way to whom would not count between them.
                    process_group=0,
                    preexec_fn=partial(_prepare_child, spec.processor),
                )
                self._children[spec.name] = child
                self._starts[spec.name] = self._starts.get(spec.name, 0) + 1
                if spec.beats:
                    self._hearts.born(child.pid, time.monotonic())
                self._write_pids()
                return child
        finally:
            if output is not None:
                output.close()

    def _hear(self) -> None:
        while not self._stopping.is_set():
            pid = self._listener.receive(LOOK_S)
            with self._lock:
                silent = self._hearts.heard(pid, time.monotonic())
                for name, child in self._children.items():
                    if child.pid in silent:
                        log.error("%s gives no sign of life any more, killing it", name)
                        self._hearts.died(child.pid)
                        child.kill()

    def _open_log(self, spec: ProcessSpec) -> IO[bytes] | None:
        if self._logs is None:
            return None
        try:
            self._logs.mkdir(parents=True, exist_ok=True)
            return (self._logs / f"{spec.name}.log").open("ab")
        except OSError as error:  # a process without a log is better than none
            log.error("%s has no log: %s", spec.name, error)
            return None

    def _write_pids(self) -> None:
        if self._pid_file is None:
            return
        pids = {
            name: {"pid": child.pid, "starts": self._starts[name]}
            for name, child in self._children.items()
        }
        partial = self._pid_file.with_suffix(".partial")
        try:
            partial.write_text(json.dumps(pids, indent=2))
            partial.replace(self._pid_file)
        except OSError as error:  # the children matter, not what is written of them
            log.error("cannot write %s: %s", self._pid_file, error)


def _prepare_child(processor: int | None) -> None:
    # In the background of our terminal, where ``stty tostop`` would stop it for what it says.
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    die_with_parent()
    if processor is not None:
        with suppress(OSError):  # it may have been taken from us meanwhile
            os.sched_setaffinity(0, {processor})


def die_with_parent() -> None:
    """Run in a child before its program: it is told to stop when its parent is gone (Linux)."""
    # The signal comes when the thread that forked ends, and that thread waits for the child.
    if _libc is not None:
        _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
