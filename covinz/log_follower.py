"""Follows the keyframe log: start, restart and lost publications are one code path."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass

from covinz import codec, keyexprs
from covinz.bus import Bus, BusClosed
from covinz.machine import THIS_MACHINE, Machine
from covinz.types import LogHead, LogMark, LogPage, LogRange, LogView

logger = logging.getLogger(__name__)

# Without news the head is asked for so often: publications may be lost. [s]
RECHECK_S = 2.0
# At the head it is asked for entries so often at most, and gets all that came meanwhile: a page of
# one costs ingest, router and follower as much as one of many. [s; decision 0036]
GATHER_S = 0.1
# Pauses while ingest does not answer grow from ... to ...; its return ends a pause. [s]
MIN_PAUSE_S = 0.1
MAX_PAUSE_S = 2.0
# `close` waits so long for the thread; it may be inside a question or the consumer. [s]
CLOSE_S = 2.0


@dataclass(frozen=True, slots=True)
class LogReset:
    """The log is not the one that was followed: forget everything, entries follow from 0 on."""

    log_id: str


class _NoPage(Exception):
    """There is no usable answer from ingest now."""


class LogFollower:
    """Delivers every entry of the log once and in order, from a thread of its own.

    Args:
        bus: Way to ingest.
        view: How much of each keyframe to ask for.
        deliver: Called with a LogReset or a LogPage that holds entries; consecutive pages join
            without gap or overlap. It may block: nothing is asked for meanwhile.
        recheck_s: How often to look without being woken.
        machine: For the thread.

    Source: docs/architecture.md, "log with cursors".
    """

    def __init__(
        self,
        bus: Bus,
        view: LogView,
        deliver: Callable[[LogReset | LogPage], object],
        recheck_s: float = RECHECK_S,
        machine: Machine = THIS_MACHINE,
    ) -> None:
        self._bus = bus
        self._view = view
        self._deliver = deliver
        self._recheck_s = recheck_s
        self._cursor = 0
        self._log_id = ""
        self._chain = ""
        self._mark: LogMark | None = None
        self._clock_s = machine.monotonic_s
        self._asked_s = -math.inf
        self._news = machine.event()
        self._closed = machine.event()
        self._thread = machine.thread(self._run, "log-follower", daemon=True)
        self._declared = ExitStack()

    def start(self, cursor: int, log_id: str, mark: LogMark | None = None) -> None:
        """Begin to follow; call it once.

        Args:
            cursor: Index of the first entry that is wanted.
            log_id: The log that `cursor` refers to; empty when none was followed before, and then
                a LogReset comes first.
            mark: How much of which log the consumer's file has to do with. Ingest is told before
                anything else: if its log is another one it says so by another identity.
        """
        self._cursor, self._log_id = cursor, log_id
        self._mark = mark if mark is not None and mark.log_id else None
        for declared in (
            self._bus.subscribe(keyexprs.LOG_HEAD, self._on_head),
            self._bus.watch_answered(keyexprs.LOG_RANGE, self._on_ingest),
        ):
            self._declared.enter_context(closing(declared))
        self._thread.start()

    def close(self, timeout_s: float = CLOSE_S) -> None:
        """Deliver nothing more; waits at most `timeout_s` for what is under way."""
        self._closed.set()
        self._news.set()
        self._declared.close()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout_s)

    def _on_head(self, _: str, payload: bytes) -> None:
        try:
            codec.decode(payload, LogHead)
        except codec.MalformedMessage as error:
            logger.warning("ignoring a malformed head of the log: %s", error)
        else:
            self._news.set()

    def _on_ingest(self, is_there: bool) -> None:
        if is_there:
            self._news.set()

    def _run(self) -> None:
        pause_s = MIN_PAUSE_S
        while not self._closed.is_set():
            self._news.clear()
            try:
                at_head = self._step()
            except BusClosed:
                return
            except _NoPage as reason:
                logger.log(
                    logging.WARNING if pause_s == MAX_PAUSE_S / 2 else logging.DEBUG,
                    "the log cannot be read from %d on: %s",
                    self._cursor,
                    reason,
                )
                self._wait(pause_s)
                pause_s = min(2 * pause_s, MAX_PAUSE_S)
                continue
            pause_s = MIN_PAUSE_S
            if at_head:
                self._wait(self._recheck_s)
                self._closed.wait(max(0.0, self._asked_s + GATHER_S - self._clock_s()))

    def _wait(self, timeout_s: float) -> None:
        if not self._closed.is_set():
            self._news.wait(timeout_s)

    def _step(self) -> bool:
        """Ask for one page and deliver it; whether the head is reached."""
        if self._mark is not None:
            self._ask(LogRange(self._mark.index, self._view, self._mark.log_id, self._mark.chain))
            self._mark = None
        self._asked_s = self._clock_s()
        page = self._page()
        if self._closed.is_set():
            return True
        if page.log_id != self._log_id or self._cursor > page.head:
            logger.info("following log %s from its beginning", page.log_id)
            self._log_id, self._cursor, self._chain = page.log_id, 0, ""
            self._deliver(LogReset(page.log_id))
            return False
        if page.entries:
            self._cursor += len(page.entries)
            self._chain = page.chain
            self._deliver(page)
        return self._cursor >= page.head

    def _ask(self, question: LogRange) -> LogPage:
        replies = self._bus.ask(keyexprs.LOG_RANGE, codec.encode(question))
        if not replies:
            raise _NoPage("ingest does not answer")
        try:
            return codec.decode(replies[0], LogPage)
        except codec.MalformedMessage as error:
            raise _NoPage(str(error)) from error

    def _page(self) -> LogPage:
        page = self._ask(LogRange(self._cursor, self._view, self._log_id, self._chain))
        same_log = page.log_id == self._log_id and self._cursor <= page.head
        first = page.entries[0].log_index if page.entries else self._cursor
        if same_log and (first != self._cursor or (not page.entries and first < page.head)):
            raise _NoPage(f"asked for {self._cursor}, got {first} with {len(page.entries)} entries")
        return page
