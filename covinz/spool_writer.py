"""Between `Agent.send` and the spool: a disk that is slow or full never holds up the robot.

A thread of its own writes what was handed over, oldest first, several in one commit.
Who hands over waits for that commit, but only so long; then it goes on and the disk follows.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

from covinz import spool_rows
from covinz.config import AgentConfig
from covinz.machine import THIS_MACHINE, Machine
from covinz.spool import Spool, SpoolError
from covinz.spool_rows import SpoolEntry
from covinz.types import KeyframeId

logger = logging.getLogger(__name__)


class StampError(ValueError):
    """A keyframe is older than the one before it in its session: begin a new session first."""


@dataclass(frozen=True, slots=True)
class _Segment:
    """Where a session is."""

    session: str
    next_seq: int
    last_stamp_ns: int

    def after(self, entry: SpoolEntry) -> _Segment:
        return replace(self, next_seq=entry.id.seq + 1, last_stamp_ns=entry.stamp_ns)


@dataclass(slots=True, eq=False)
class _Handed:
    """A keyframe that was handed over.

    Attributes:
        entry: The keyframe.
        before: Where the session was before it.
        is_awaited: Whoever handed it over still waits, and can be told that it failed.
        is_done: It is on the disk, or `error` says why not.
        error: Why it was not accepted.
    """

    entry: SpoolEntry
    before: _Segment
    is_awaited: bool = True
    is_done: bool = False
    error: SpoolError | None = None


class SpoolWriter:
    """Writes keyframes to a spool in a thread of its own; safe to use from several threads.

    Args:
        spool: Where to.
        session: Current session, which may have keyframes already.
        config: How long to wait for the disk, and how much may wait for it.
        on_saved: Called from the thread after each commit.
        machine: For the thread.
        retry_s: Between two attempts to write to a disk that failed. [s]

    Source: decision 0027.
    """

    def __init__(
        self,
        spool: Spool,
        session: str,
        config: AgentConfig,
        on_saved: Callable[[], None],
        machine: Machine = THIS_MACHINE,
        retry_s: float = 1.0,
    ) -> None:
        self._spool = spool
        self._config = config
        self._on_saved = on_saved
        self._retry_s = retry_s
        self._changed = machine.condition()  # guards what follows; never held during a write
        self._segment = _Segment(session, *spool.session(session))
        self._queue: list[_Handed] = []
        self._bytes = 0
        self._failure: SpoolError | None = None
        self._stopping = False
        self._thread = machine.thread(self._run, "spool", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    @property
    def unsaved(self) -> int:
        """Keyframes that were accepted and are not yet on the disk."""
        return len(self._queue)

    @property
    def session(self) -> str:
        """Current session."""
        return self._segment.session

    def new_session(self, session: str) -> None:
        """Keyframes that come from now on belong to this session, which has none yet."""
        with self._changed:
            self._segment = _Segment(session, 0, 0)

    def put(self, encode: Callable[[str, int], SpoolEntry]) -> KeyframeId:
        """Accept a keyframe; wait for the disk, but no longer than `max_send_wait_s`.

        Args:
            encode: Makes the message for a session and number; no number is used up if it raises.

        Raises:
            StampError: If the session has a later keyframe.
            SpoolError: If it was not accepted: the disk is full or has been too slow for long.
        """
        with self._changed:
            before = self._segment
            handed = _Handed(encode(before.session, before.next_seq), before)
            _check_order(handed.entry.stamp_ns, before.last_stamp_ns)
            self._refuse_if_stuck(handed)
            self._segment = before.after(handed.entry)
            self._queue.append(handed)
            self._bytes += len(handed.entry.payload)
            self._changed.notify_all()
            self._changed.wait_for(lambda: handed.is_done, self._config.max_send_wait_s)
            handed.is_awaited = False
            if handed.error is not None:
                raise handed.error
            return handed.entry.id

    def wait_saved(self, timeout_s: float | None) -> bool:
        """Wait until everything accepted is on the disk; False when time ran out first."""
        with self._changed:
            return bool(self._changed.wait_for(lambda: not self._queue, timeout_s))

    def stop(self, timeout_s: float) -> None:
        """Write what was accepted, but for so long only, and accept nothing more."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join(timeout_s)
        if self._queue:
            reason = self._failure or "the disk is too slow"
            logger.error("%d keyframes are lost: %s", len(self._queue), reason)

    def _refuse_if_stuck(self, handed: _Handed) -> None:
        """Raise SpoolError if what came before is still not on the disk, and why."""
        if self._stopping:
            raise SpoolError("the agent is closed")
        if self._queue and self._failure is not None:
            raise SpoolError(str(self._failure))
        if self._bytes + len(handed.entry.payload) > self._config.max_unsaved_bytes:
            raise SpoolError(f"the disk is too slow: {len(self._queue)} keyframes wait for it")

    def _run(self) -> None:
        while batch := self._next():
            error = self._write(batch)
            with self._changed:
                if error is None:
                    self._saved(batch)
                else:
                    self._failed(error)
                self._changed.notify_all()
            if error is None:
                self._on_saved()

    def _write(self, batch: list[_Handed]) -> SpoolError | None:
        """Write to the disk; what is wrong, if it fails."""
        try:
            self._spool.append([handed.entry for handed in batch])
        except SpoolError as error:
            if self._failure is None:
                logger.error("cannot write keyframes to the disk: %s", error)
            return error
        except Exception as error:  # a mistake of ours must not end the thread
            logger.exception("cannot write keyframes to the disk")
            return SpoolError(f"cannot write keyframes to the disk: {error}")
        return None

    def _next(self) -> list[_Handed]:
        """What waits, the oldest of it, once there is something; nothing at the end."""
        with self._changed:
            if self._queue and self._failure is not None and not self._stopping:
                self._changed.wait_for(lambda: self._stopping, self._retry_s)
            elif self._failure is not None and self._stopping:
                return []
            self._changed.wait_for(lambda: self._stopping or self._queue)
            return self._batch()

    def _batch(self) -> list[_Handed]:
        batch: list[_Handed] = []
        size = 0
        for handed in self._queue:
            size += len(handed.entry.payload)
            if batch and size > spool_rows.BATCH_BYTES:
                break
            batch.append(handed)
        return batch

    def _saved(self, batch: list[_Handed]) -> None:
        self._failure = None
        del self._queue[: len(batch)]
        for handed in batch:
            self._bytes -= len(handed.entry.payload)
            handed.is_done = True

    def _failed(self, error: SpoolError) -> None:
        """Give back those, from the newest on, whose senders can still be told; keep the rest."""
        self._failure = error
        while self._queue and self._queue[-1].is_awaited:
            handed = self._queue.pop()
            self._bytes -= len(handed.entry.payload)
            handed.error, handed.is_done = error, True
            if handed.before.session == self._segment.session:
                self._segment = handed.before


def _check_order(stamp_ns: int, last_stamp_ns: int) -> None:
    if stamp_ns < last_stamp_ns:
        late_s = (last_stamp_ns - stamp_ns) / 1e9
        raise StampError(
            f"stamp {stamp_ns} is {late_s:.3f} s before the last one of the session; if the clock "
            "was set, call new_session() and send it again"
        )
