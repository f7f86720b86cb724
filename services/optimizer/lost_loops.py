"""Asks the dispatcher's journal for accepted loops that the store has lost, or never had.

The store may be new, or restored from a backup that is older than the journal. Then the loops that
workers were told are safe are in the journal alone.

Source: decision 0028.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

from covinz import codec, keyexprs
from covinz.bus import Bus, BusClosed
from covinz.machine import THIS_MACHINE, Machine
from covinz.types import LoopClosure, LoopPage, LoopRange

logger = logging.getLogger(__name__)

# Between two questions to a dispatcher that does not answer, or not of this log yet. [s]
PAUSE_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LoopsFound:
    """Some accepted loops of a log; none: that was all."""

    log_id: str
    loops: tuple[LoopClosure, ...]


class LostLoops:
    """A thread that reads the journal's loops from their beginning whenever it is asked to.

    Args:
        bus: Way to the dispatcher.
        deliver: Gets LoopsFound; it may block.
        machine: For the thread.
    """

    def __init__(
        self, bus: Bus, deliver: Callable[[object], object], machine: Machine = THIS_MACHINE
    ) -> None:
        self._bus = bus
        self._deliver = deliver
        self._changed = machine.condition()  # guards what follows
        self._wanted = ""
        self._passes = self._done = 0
        self._closing = False
        self._answered = bus.watch_answered(keyexprs.JOB_LOOPS, self._on_answered)
        self._thread = machine.thread(self._run, "lost-loops", daemon=True)
        self._thread.start()

    def look(self, log_id: str) -> None:
        """Deliver all accepted loops of a log, then an empty LoopsFound."""
        with self._changed:
            self._wanted = log_id
            self._passes += 1
            self._changed.notify_all()

    def close(self) -> None:
        """Deliver nothing more."""
        self._answered.close()
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def _on_answered(self, is_there: bool) -> None:
        if is_there:
            with self._changed:
                self._changed.notify_all()

    def _run(self) -> None:
        log_id = ""
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._closing or self._passes > self._done)
                    if log_id == self._wanted:  # what was found could not be stored
                        self._changed.wait_for(lambda: self._closing, PAUSE_S)
                    if self._closing:
                        return
                    log_id, number = self._wanted, self._passes
                if self._read(log_id, number):
                    self._done = number
        except BusClosed:
            return

    def _read(self, log_id: str, number: int) -> bool:
        """One pass; False when another one was asked for, or it is over."""
        after = ""
        while True:
            page = self._page(after)
            with self._changed:
                if self._closing or self._passes != number:
                    return False
                if page is None or page.log_id != log_id:
                    self._changed.wait(PAUSE_S)
                    continue
            self._deliver(LoopsFound(log_id, page.loops))
            if not page.loops:
                return True
            after = page.loops[-1].job_id

    def _page(self, after: str) -> LoopPage | None:
        for reply in self._bus.ask(keyexprs.JOB_LOOPS, codec.encode(LoopRange(after))):
            try:
                return codec.decode(reply, LoopPage)
            except codec.MalformedMessage as error:
                logger.error("unreadable answer on %s: %s", keyexprs.JOB_LOOPS, error)
        return None
