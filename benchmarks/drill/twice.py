"""A loop solver that does the work of two: whatever it brings, a second session brings too.

    python -m benchmarks.drill.twice --config FILE --data DIR --id NAME

The two say the same at the same time, as when a job was lent again since its worker was thought
dead. Solving and protocol are the real ones.
"""

from __future__ import annotations

import argparse
import signal
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from covinz import config, keyexprs
from covinz.bus import Bus, Closable, Query, ZenohBus
from covinz.config import BusConfig
from covinz.logs import set_up_logging
from covinz.service import Inbox, serve_on
from services.loop_solver.service import run

_BROUGHT = (keyexprs.LOOP, keyexprs.JOB_DONE)


class TwoSessions:
    """A bus whose loops and outcomes go through two sessions at once."""

    def __init__(self, settings: BusConfig) -> None:
        self._first, self._second = (ZenohBus.open(settings, wait_s=0.0) for _ in range(2))

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        """See `Bus`; the answer is the first session's."""
        if key not in _BROUGHT:
            return self._first.ask(key, payload, timeout_s)
        other = threading.Thread(target=self._second.ask, args=(key, payload, timeout_s))
        other.start()
        try:
            return self._first.ask(key, payload, timeout_s)
        finally:
            other.join()

    def put(self, key: str, payload: bytes) -> None:
        """See `Bus`."""
        self._first.put(key, payload)

    def subscribe(self, key: str, callback: Callable[[str, bytes], None]) -> Closable:
        """See `Bus`."""
        return self._first.subscribe(key, callback)

    def answer(self, key: str, callback: Callable[[Query], None]) -> Closable:
        """See `Bus`."""
        return self._first.answer(key, callback)

    def watch_answered(self, key: str, callback: Callable[[bool], None]) -> Closable:
        """See `Bus`."""
        return self._first.watch_answered(key, callback)

    def declare_alive(self, key: str) -> Closable:
        """See `Bus`."""
        return self._first.declare_alive(key)

    def watch_alive(self, key: str, callback: Callable[[str, bool], None]) -> Closable:
        """See `Bus`."""
        return self._first.watch_alive(key, callback)

    def interrupt(self) -> None:
        """See `Bus`."""
        self._first.interrupt()
        self._second.interrupt()

    def close(self) -> None:
        """See `Bus`."""
        self._first.close()
        self._second.close()


def main() -> None:
    """Be a loop solver until SIGTERM."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--id", required=True)
    arguments = parser.parse_args()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    set_up_logging("loop_solver", arguments.id)
    settings = config.load(arguments.config)
    bus: Bus = TwoSessions(settings.bus)
    with closing(bus):
        serve_on(bus, "loop_solver", arguments.id, settings, arguments.data, run, _stop_on_signal)


def _stop_on_signal(inbox: Inbox, bus: Bus) -> None:
    def wait() -> None:
        signal.sigwait({signal.SIGTERM})
        inbox.stop()
        bus.interrupt()

    threading.Thread(target=wait, daemon=True).start()


if __name__ == "__main__":
    main()
