"""``python -m covinz.health SERVICE --id NAME``: does a process answer for its state on the bus?

For health checks of containers. The answer comes from the thread that owns the service's state,
through the router: whoever answers is up, connected and not stuck. Exit codes: see `Health`.
"""

from __future__ import annotations

import argparse
import enum
import logging
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from covinz import codec, config, keyexprs
from covinz.bus import Bus, BusError, ZenohBus
from covinz.program import instance_name
from covinz.types import Status

logger = logging.getLogger(__name__)

# A machine that is busy is not a process that is stuck: with ten programs for each core an answer
# took more than 5 s. [s]
TIMEOUT_S = 20.0
# It is asked for at least so long, also when it appeared just in time. [s]
MIN_ASK_S = 0.1


class Health(enum.IntEnum):
    """What was found; the exit code of the command."""

    ANSWERS = 0
    SILENT = 1
    # A configuration that no session can be opened with; also wrong arguments.
    UNUSABLE = 2
    NO_ROUTER = 3


def main(argv: Sequence[str] | None = None) -> Health:
    """Run the command; returns its exit code."""
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    arguments = _parser().parse_args(argv)
    service, instance = arguments.service, instance_name(arguments.id or arguments.service)
    deadline = time.monotonic() + arguments.timeout
    try:
        settings = config.load(arguments.config)
        bus = ZenohBus.open(settings.bus, wait_s=0.0)
    except (config.ConfigError, BusError) as error:
        logger.error("%s", error)
        return Health.UNUSABLE
    with closing(bus):
        if not bus.wait_connected(arguments.timeout):
            logger.error("no router at %s", settings.bus.endpoint)
            return Health.NO_ROUTER
        status = ask(bus, service, instance, deadline - time.monotonic())
    if status is None:
        logger.error("%s/%s does not answer", service, instance)
        return Health.SILENT
    sys.stdout.write(f"{describe(status)}\n")
    return Health.ANSWERS


def ask(bus: Bus, service: str, instance: str, timeout_s: float) -> Status | None:
    """The status of one process, or None when it did not answer in time.

    Args:
        bus: A bus that is connected.
        service: Kind of process.
        instance: Which one of several.
        timeout_s: For it to appear and to answer.

    Raises:
        MalformedMessage: If the answer is no status.
    """
    deadline = time.monotonic() + timeout_s
    key = keyexprs.service_status(service, instance)
    there = threading.Event()
    watch = bus.watch_answered(key, lambda answered: there.set() if answered else None)
    with closing(watch):
        there.wait(max(0.0, timeout_s))
    replies = bus.ask(key, timeout_s=max(MIN_ASK_S, deadline - time.monotonic()))
    return codec.decode(replies[0], Status) if replies else None


def describe(status: Status) -> str:
    """One line for the log of health checks."""
    state = f"cursor {status.cursor}, pending {status.pending}, leased {status.leased}"
    return f"{status.service}/{status.instance}: {state}{', dirty' if status.dirty else ''}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m covinz.health", description="Ask one process of a server how it is."
    )
    parser.add_argument("service", help="kind of process, e.g. ingest")
    parser.add_argument("--id", metavar="NAME", help="which one of several [the service's name]")
    parser.add_argument("--config", type=Path, metavar="FILE", help="as the process was given")
    parser.add_argument(
        "--timeout", type=float, default=TIMEOUT_S, metavar="S", help=f"[{TIMEOUT_S:g}]"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
