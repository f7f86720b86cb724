"""The shell of every server process: arguments, logging, signals, bus, inbox, status.

A service is a function `run(context)` in the main thread, which owns all state. Bus callbacks and
other threads only put events into `context.inbox`. The process is announced (liveliness token)
when `run` first looks into its inbox, so everything that it declared before is there by then.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from covinz import codec, keyexprs
from covinz import config as configuration
from covinz.beats import Beats
from covinz.bus import Bus, BusClosed, BusError, Query, ZenohBus
from covinz.config import Config, ConfigError, HealthConfig
from covinz.durable import DurableFileError
from covinz.endpoint import HealthEndpoint, Probe
from covinz.inbox import Inbox, Stopped
from covinz.logs import LogFormat, set_up_logging
from covinz.machine import THIS_MACHINE, Machine
from covinz.niceness import SHORT_TURNS_S, give_way, take_turns
from covinz.program import VERSION, instance_name
from covinz.telemetry import Telemetry
from covinz.types import Status
from covinz.watch import Guard, Watch, end_with_failed_thread

__all__ = ["Context", "Inbox", "StatusRequest", "Stopped", "serve", "serve_on"]

logger = logging.getLogger(__name__)

# A thread that computes lets a waiting one go on after this long: a request that comes in while an
# entry is looked up or a map is optimised must not wait Python's 5 ms for each step of its way.
# [s; measured with benchmarks/load.py: two solvers do 9 % more jobs]
SWITCH_INTERVAL_S = 0.0005
# What a message passes through on its way in is the work of one thread of Zenoh's: waking another
# one costs more than the work. What goes out keeps a thread of its own. Not so in the router: there
# the thread that reads waits where a receiver's queue is full, and must not be the one that listens
# for sockets that have room again. [measured: decision 0033; source: `ZENOH_RUNTIME`]
ZENOH_THREADS = "(rx: (worker_threads: 1), net: (handover: rx), app: (handover: rx))"

# Questions that a process still waits for so long after it was told to stop are ended. [s]
STOP_GRACE_S = 3.0
# When all is done, the session and the interpreter may take so long to close. A session whose
# router had vanished was once seen not to. [s]
LEAVE_S = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class StatusRequest:
    """Somebody asks how far this process is: ``event.answer(Status(...))``."""

    query: Query
    machine: Machine = THIS_MACHINE

    def answer(self, status: Status) -> None:
        """Answer, with the version of this program and its clock."""
        told = replace(status, version=VERSION, now_ns=self.machine.now_ns())
        self.query.reply(codec.encode(told))


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """What a service is given.

    Attributes:
        name: Kind of process, e.g. ``ingest``.
        instance: Which one of several.
        config: The configuration in force.
        data_dir: Folder for durable files; it exists.
        bus: The bus; closed after `run` has returned.
        inbox: Events for the owner thread; StatusRequest comes here by itself.
        machine: Clocks, chance and threads.
        watch: Where work that must not take for ever is declared.
        telemetry: Where durations are counted.
    """

    name: str
    instance: str
    config: Config
    data_dir: Path
    bus: Bus
    inbox: Inbox
    machine: Machine = THIS_MACHINE
    watch: Watch = field(default_factory=Watch)
    telemetry: Telemetry = field(default_factory=Telemetry)


def serve(name: str, run: Callable[[Context], None]) -> None:
    """Be a service process: parse arguments, call `run`, end the process.

    Exits with 0 after SIGTERM or SIGINT, with 2 for unusable arguments or configuration, with 1
    when `run` raised or returned unasked or a thread failed, and with `covinz.watch.STUCK` when it
    was stuck: whoever supervises starts it again.

    Args:
        name: Kind of process; its key expressions are ``covinz/service/{name}/{id}/...``.
        run: Serves until ``context.inbox.take`` raises Stopped, then lets it through or returns.
    """
    # Blocked in this thread and all it starts: a thread of its own waits for them, so that no
    # code is ever interrupted half-way by a signal handler.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
    arguments = _arguments(name)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    if name != "router":
        os.environ.setdefault("ZENOH_RUNTIME", ZENOH_THREADS)
    set_up_logging(name, instance_name(arguments.id), form=arguments.log_format)
    try:
        config = configuration.load(arguments.config)
        arguments.data.mkdir(parents=True, exist_ok=True)
        # Before there are threads: each has a niceness of its own.
        give_way(config.niceness.model_dump().get(name, 0))
        take_turns(SHORT_TURNS_S)
        bus = ZenohBus.open(config.bus, wait_s=0.0)
    except (ConfigError, BusError, OSError) as error:
        logger.error("%s", error)
        sys.exit(2)
    watch, stopping, ended = Watch(), threading.Event(), threading.Event()
    end_with_failed_thread(stopping.is_set)
    guard = Guard(watch, Beats.of_process().send, config.health.hang_s)
    guard.start()
    telemetry = Telemetry()

    def arm(inbox: Inbox, _: Bus) -> None:
        _stop_on_signal(stopping, ended, inbox, bus)
        ask = partial(_ask_status, inbox, THIS_MACHINE)
        probe = Probe(name, ask, bus, lambda: bus.is_connected, watch, telemetry)
        _tell_over_http(config.health, arguments.port_offset, probe)

    code = serve_on(
        bus,
        name,
        instance_name(arguments.id),
        config,
        arguments.data,
        run,
        arm,
        watch=watch,
        telemetry=telemetry,
    )
    stopping.set()
    ended.set()
    guard.stop()
    faulthandler.dump_traceback_later(LEAVE_S, exit=True)
    bus.close()
    logging.shutdown()
    sys.exit(code)


def serve_on(
    bus: Bus,
    name: str,
    instance: str,
    config: Config,
    data_dir: Path,
    run: Callable[[Context], None],
    arm: Callable[[Inbox, Bus], object],
    machine: Machine = THIS_MACHINE,
    watch: Watch | None = None,
    telemetry: Telemetry | None = None,
) -> int:
    """Run a service on a given bus; returns the exit code of its process.

    Args:
        bus: The bus; stays open.
        name: See `serve`.
        instance: Which one of several.
        config: The configuration.
        data_dir: Folder for durable files.
        run: See `serve`.
        arm: Called with inbox and bus before `run`; arranges for ``inbox.stop()``.
        machine: What the process runs on.
        watch: Looked at by somebody else; default: by nobody.
        telemetry: The same.
    """
    watch = watch or Watch(machine.monotonic_s)
    telemetry = telemetry or Telemetry(machine)
    owner = watch.work("the main loop", config.health.hang_s)
    with contextlib.ExitStack() as stack:
        announce = partial(_announce, stack, bus, name, instance)
        inbox = Inbox(on_first_take=announce, machine=machine, owner=owner)
        stack.callback(_drop_status_requests, inbox)
        status_key = keyexprs.service_status(name, instance)
        status = bus.answer(status_key, partial(_ask_status, inbox, machine))
        stack.callback(status.close)
        arm(inbox, bus)
        try:
            run(Context(name, instance, config, data_dir, bus, inbox, machine, watch, telemetry))
        except Stopped:
            pass
        except BusClosed:
            if not inbox.is_stopping:
                logger.exception("the bus was closed")
                return 1
        except (BusError, DurableFileError) as error:
            logger.error("%s", error)
            return 1
        except Exception:
            logger.exception("%s failed", name)
            return 1
        if not inbox.is_stopping:
            logger.error("%s ended without being asked", name)
            return 1
        logger.info("stopped")
        return 0


def _arguments(name: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=f"python -m services.{name}")
    parser.add_argument("--config", type=Path, metavar="FILE", help="YAML; default: defaults")
    parser.add_argument(
        "--data", type=Path, metavar="DIR", default=Path("data"), help="folder for durable files"
    )
    parser.add_argument(
        "--id", metavar="NAME", default=name, help="which one of several; {host}: this machine's"
    )
    parser.add_argument(
        "--log-format", type=LogFormat, choices=list(LogFormat), help="[COVINZ_LOG_FORMAT or text]"
    )
    parser.add_argument(
        "--port-offset", type=int, metavar="N", default=0, help="added to health.port"
    )
    return parser.parse_args()


def _announce(stack: contextlib.ExitStack, bus: Bus, name: str, instance: str) -> None:
    token = bus.declare_alive(keyexprs.service_alive(name, instance))
    stack.callback(token.close)
    logger.info("ready")


def _tell_over_http(config: HealthConfig, offset: int, probe: Probe) -> None:
    if config.port is None:
        return
    port = config.port + offset if config.port else 0
    try:
        logger.info("health and metrics at %s", HealthEndpoint(config, port, probe).url)
    except (OSError, OverflowError) as error:  # the service matters, not what is told of it
        logger.error("no health and metrics at %s:%d: %s", config.address, port, error)


def _ask_status(inbox: Inbox, machine: Machine, query: Query) -> None:
    if not inbox.put_always(StatusRequest(query, machine)):
        query.drop()


def _drop_status_requests(inbox: Inbox) -> None:
    for event in inbox.drain(len(inbox)):
        if isinstance(event, StatusRequest):
            event.query.drop()


def _stop_on_signal(
    stopping: threading.Event, ended: threading.Event, inbox: Inbox, bus: Bus
) -> None:
    def wait() -> None:
        number = signal.sigwait({signal.SIGTERM, signal.SIGINT})
        logger.info("stopping on %s", signal.Signals(number).name)
        stopping.set()
        inbox.stop()
        if not ended.wait(STOP_GRACE_S):
            bus.interrupt()

    threading.Thread(target=wait, name="signals", daemon=True).start()
