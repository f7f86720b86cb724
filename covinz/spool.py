"""The spool: keyframes that a robot has sent and the server has not acknowledged, on its disk."""

from __future__ import annotations

import logging
import sqlite3
import threading
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from covinz import spool_rows
from covinz.config import AgentConfig
from covinz.dead_letters import DeadLetter, DeadLetters, now_text
from covinz.disk_reserve import DiskReserve
from covinz.durable import DurableFile, DurableFileError
from covinz.machine import THIS_MACHINE, Machine
from covinz.spool_rows import SpoolEntry, SpoolRow
from covinz.types import KeyframeId, Rejected

logger = logging.getLogger(__name__)

# What a row takes in the file besides its payload, at most. [bytes]
_SPARE_BYTES = 64 * 1024


class SpoolError(RuntimeError):
    """The spool cannot be used: disk full, damaged, another agent's, or in use."""


class _DiskFull(SpoolError):
    """There may be room once what is settled is deleted."""


@dataclass(frozen=True, slots=True)
class SpoolReport:
    """What a spool holds, and what it had to give up since it was made.

    Attributes:
        pending: Uploads that wait or are under way.
        bytes: Their size.
        dropped: Keyframes given up: too many, too old, or damaged on the disk. The server has
            been told, or will be.
        rejected: Keyframes that the server refused for good.
    """

    pending: int
    bytes: int
    dropped: int
    rejected: int


class Spool:
    """Uploads of one agent, of this run and of earlier ones; safe to use from several threads.

    A row that `take` hands out is in flight until `delivered`, `rejected` or `release`; nobody
    else gets it meanwhile. Beyond `max_spool_bytes` the oldest keyframes that are not in flight
    make way for a gap that says so and is delivered in their place; so do those beyond
    `max_spool_age_s`. (If only the acknowledgement of a dropped keyframe was lost, the log holds
    the keyframe as well as the gap.)

    Args:
        path: SQLite file; made when it is not there. Refused uploads go to the folder
            ``<path>.rejected``.
        agent: Whose keyframes they are.
        config: Sizes and age.
        machine: Clocks.

    Raises:
        SpoolError: From every method.

    Source: decision 0027.
    """

    def __init__(
        self, path: Path, agent: str, config: AgentConfig, machine: Machine = THIS_MACHINE
    ) -> None:
        self._agent = agent
        self._config = config
        self._machine = machine
        self._letters = DeadLetters(Path(f"{path}.rejected"), config.max_rejected_bytes)
        self._reserve = DiskReserve(Path(f"{path}.reserve"), spool_rows.RESERVE_BYTES)
        self._room = threading.RLock()  # nothing is added while the reserve is given up
        self._lock = threading.Lock()  # the connection and what follows
        self._in_flight: set[int] = set()
        self._sent_gaps: set[int] = set()
        # Acknowledged, but not yet deleted since the disk was full; also in flight.
        self._settled: set[int] = set()
        self._clock_began_s = 0.0
        self._gone: set[int] = set()  # deleted by the transaction under way
        # Of the file; of the transaction under way; and what others may see at any time.
        self._stored = self._counts = self._report = SpoolReport(0, 0, 0, 0)
        try:
            self._file = DurableFile(path, spool_rows.SPOOL_FILE)
        except DurableFileError as error:
            raise SpoolError(str(error)) from error
        try:
            with _spool_errors(path):
                self._open()
        except BaseException:
            self._file.close()
            raise

    def __len__(self) -> int:
        """Uploads that wait or are in flight; never waits for the disk."""
        return self._report.pending

    def report(self) -> SpoolReport:
        """What it holds; never waits for the disk."""
        return self._report

    def session(self, session: str) -> tuple[int, int]:
        """The number of a session's next keyframe, and the time stamp of its last one."""
        with self._lock, _spool_errors(self._file.path):
            row = self._file.db.execute(
                "SELECT next_seq, last_stamp_ns FROM session WHERE session = ?", (session,)
            ).fetchone()
        return row or (0, 0)

    def append(self, entries: Sequence[SpoolEntry]) -> None:
        """Add keyframes, all or none; they are on the disk when this returns."""
        with self._room:
            try:
                if not self._reserve.take():
                    raise _DiskFull(f"{self._file.path}: the disk is full")
                self._append(entries)
            except _DiskFull:
                if not (self._tidied_up() and self._fits_inside(entries)):
                    raise
                self._append_inside(entries)

    def _append_inside(self, entries: Sequence[SpoolEntry]) -> None:
        """Add keyframes where only the file itself has room; the reserve is lent to its log."""
        self._reserve.give_up()
        try:
            self._append(entries)
            self._empty_log()
        finally:
            self._reserve.take()

    def _fits_inside(self, entries: Sequence[SpoolEntry]) -> bool:
        with self._lock, _spool_errors(self._file.path):
            db = self._file.db
            (pages,) = db.execute("PRAGMA freelist_count").fetchone()
            (page_bytes,) = db.execute("PRAGMA page_size").fetchone()
        size = sum(len(entry.payload) + len(entry.camera_payload) for entry in entries)
        return size <= spool_rows.BATCH_BYTES and pages * page_bytes >= 2 * size + _SPARE_BYTES

    def _append(self, entries: Sequence[SpoolEntry]) -> None:
        with self._writing() as db:
            newest = 0
            for entry in entries:
                newest = spool_rows.insert(db, entry, self._clock_s())
                self._count(pending=1, bytes=len(entry.payload))
            self._drop_old(db)
            while self._counts.bytes > self._config.max_spool_bytes:
                oldest = spool_rows.oldest_keyframe(db, self._in_flight, newest)
                if oldest is None:
                    break
                self._drop(db, oldest, spool_rows.FULL)

    def take(self, later: Collection[int] = ()) -> SpoolRow | None:
        """The oldest upload that is not in flight, now in flight; None when there is none.

        Args:
            later: Positions that are taken only when there is nothing else.
        """
        while (row := self._oldest(later)) is not None:
            if not row.is_damaged and not self._is_old(row):
                return row
            try:
                with self._writing() as db:
                    if row.is_damaged:
                        self._mend(db, row)
                    else:
                        self._drop(db, row, spool_rows.TOO_OLD)
                        self._drop_old(db)
            finally:
                self.release(row.position)
        return None

    def release(self, position: int) -> None:
        """The upload was not answered: it waits again."""
        with self._lock:
            self._in_flight.discard(position)

    def delivered(self, position: int) -> None:
        """The upload is durable at the server: forget it, though the disk be full."""
        with self._lock:
            self._settled.add(position)
            self._report = self._without_settled()
        try:
            with self._writing(durable=False):  # if the disk forgets this, it is sent twice
                pass  # what is settled goes with any transaction
        except _DiskFull:
            self._tidied_up()
        except SpoolError as error:
            logger.debug("a delivered upload stays on the disk for now: %s", error)

    def rejected(self, position: int, answer: Rejected) -> None:
        """The server refused the upload for good: put it aside and declare a gap in its place.

        After a conflict there is no gap, for the log has a keyframe of this name; nor is there
        one for a gap.
        """
        with self._lock, _spool_errors(self._file.path):
            row = spool_rows.row_at(self._file.db, position)
        self._put_aside(row, answer)
        with self._writing() as db:
            if not row.is_gap:
                self._count(rejected=1)
            if row.is_gap or answer.code == "conflict":
                self._delete(db, row)
            else:
                self._replace_by_gap(db, row, f"rejected: {answer.code}")
        self.release(position)

    def camera(self, camera_hash: str) -> bytes:
        """The Camera message of a spooled keyframe."""
        with self._lock, _spool_errors(self._file.path):
            row: tuple[bytes] | None = self._file.db.execute(
                "SELECT payload FROM camera WHERE hash = ?", (camera_hash,)
            ).fetchone()
        if row is None:
            raise SpoolError(f"{self._file.path}: calibration {camera_hash} is missing")
        return row[0]

    def rejections(self) -> list[DeadLetter]:
        """What was refused for good and is still kept, oldest first."""
        with _spool_errors(self._letters.folder):
            return self._letters.letters()

    def send_again(self) -> int:
        """Put refused keyframes back into the queue, e.g. after a limit of the server was raised.

        Returns:
            How many.
        """
        with _spool_errors(self._letters.folder):
            again = [letter for letter in self._letters.letters() if not letter.is_gap]
            for letter in again:
                name = KeyframeId(letter.agent, letter.session, letter.first_seq)
                payload = self._letters.payload(letter)
                with self._writing() as db:
                    spool_rows.insert_again(db, name, letter.camera_hash, payload, self._clock_s())
                    self._count(pending=1, bytes=len(payload))
                self._letters.remove(letter)
        return len(again)

    def close(self, timeout_s: float = 5.0) -> bool:
        """Close the file; what waits is uploaded by whoever opens it next.

        Returns:
            False when the disk did not end what it was at for so long; then it stays open.
        """
        if not self._lock.acquire(timeout=timeout_s):
            return False
        try:
            self._file.close()
        finally:
            self._lock.release()
        return True

    # --- inside ------------------------------------------------------------------------------

    @contextmanager
    def _writing(self, durable: bool = True) -> Iterator[sqlite3.Connection]:
        """A transaction, which also deletes what is settled; the counts follow it."""
        with self._lock, _spool_errors(self._file.path):
            self._counts, self._gone = self._stored, set()
            with self._file.transaction(durable) as db:
                for position in self._settled:
                    self._delete(db, spool_rows.row_at(db, position))
                yield db
                counts = (self._clock_s(), self._counts.dropped, self._counts.rejected)
                db.execute("UPDATE owner SET clock_s = ?, dropped = ?, rejected = ?", counts)
            self._stored = self._counts
            for positions in (self._settled, self._in_flight, self._sent_gaps):
                positions -= self._gone
            self._report = self._without_settled()

    def _tidied_up(self) -> bool:
        """Delete what is settled from a full disk; whether there is room again.

        The file keeps its size, but has room inside, and the log beside it is emptied.
        """
        with self._room:
            self._reserve.give_up()
            try:
                self._empty_log()
                with self._writing():
                    pass
                self._empty_log()
            except SpoolError:
                return False
            return self._reserve.take()

    def _empty_log(self) -> None:
        with self._lock, _spool_errors(self._file.path):
            self._file.db.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def _open(self) -> None:
        db = self._file.db
        db.execute(f"PRAGMA wal_autocheckpoint = {spool_rows.CHECKPOINT_PAGES}")
        self._reserve.take()
        with self._file.transaction():
            row = db.execute("SELECT agent, clock_s, dropped, rejected FROM owner").fetchone()
            if row is None:
                row = (self._agent, 0.0, 0, 0)
                db.execute("INSERT INTO owner VALUES (?, ?, ?, ?)", row)
        agent, clock_s, dropped, rejected = row
        if agent != self._agent:
            raise SpoolError(f"{self._file.path} is the spool of agent {agent}")
        self._clock_began_s = clock_s - self._machine.monotonic_s()
        self._stored = self._report = SpoolReport(*spool_rows.usage(db), dropped, rejected)
        # A gap that may have been sent must not grow any more.
        gaps = db.execute("SELECT position FROM outbox WHERE is_gap")
        self._sent_gaps = {position for (position,) in gaps}

    def _clock_s(self) -> float:
        """The spool's own time, which nobody sets: how long it was open, in all runs together."""
        return self._clock_began_s + self._machine.monotonic_s()

    def _is_old(self, row: SpoolRow) -> bool:
        limit_s = self._config.max_spool_age_s
        return not row.is_gap and limit_s is not None and self._clock_s() - row.spooled_s > limit_s

    def _oldest(self, later: Collection[int]) -> SpoolRow | None:
        with self._lock, _spool_errors(self._file.path):
            db = self._file.db
            row = spool_rows.oldest(db, {*self._in_flight, *later})
            row = row or spool_rows.oldest(db, self._in_flight)
            if row is not None:
                self._in_flight.add(row.position)
                if row.is_gap:
                    self._sent_gaps.add(row.position)
        return row

    def _without_settled(self) -> SpoolReport:
        return replace(self._stored, pending=self._stored.pending - len(self._settled))

    def _count(self, pending: int = 0, bytes: int = 0, dropped: int = 0, rejected: int = 0) -> None:
        was = self._counts
        self._counts = SpoolReport(
            was.pending + pending, was.bytes + bytes, was.dropped + dropped, was.rejected + rejected
        )

    def _delete(self, db: sqlite3.Connection, row: SpoolRow) -> None:
        spool_rows.delete(db, row.position)
        self._count(pending=-1, bytes=-len(row.payload))
        self._gone.add(row.position)

    def _drop_old(self, db: sqlite3.Connection) -> None:
        """Give up all keyframes that are too old and not in flight."""
        while (row := spool_rows.oldest_keyframe(db, self._in_flight)) and self._is_old(row):
            self._drop(db, row, spool_rows.TOO_OLD)

    def _drop(self, db: sqlite3.Connection, row: SpoolRow, reason: str) -> None:
        """Give up a keyframe, and tell the server."""
        is_first = self._replace_by_gap(db, row, reason)
        self._count(dropped=1)
        if is_first:  # not for each one that the gap grows by
            name = f"{self._agent}/{row.session}/{row.first_seq}"
            logger.warning("giving up keyframes from %s on: %s", name, reason)

    def _replace_by_gap(self, db: sqlite3.Connection, row: SpoolRow, reason: str) -> bool:
        """Put a gap in the place of a keyframe; False where it made another gap grow."""
        put = spool_rows.put_gap(db, self._agent, row, reason, self._sent_gaps)
        self._count(pending=put.more_rows, bytes=put.more_bytes)
        return put.more_rows == 0

    def _mend(self, db: sqlite3.Connection, row: SpoolRow) -> None:
        if row.is_gap:
            first, last = row.first_seq, row.last_seq
            gap = spool_rows.write_gap(db, self._agent, row, first, last, row.reason)
            self._count(bytes=len(gap.payload) - len(row.payload))
        else:
            self._drop(db, row, spool_rows.DAMAGED)

    def _put_aside(self, row: SpoolRow, answer: Rejected) -> None:
        letter = DeadLetter(
            agent=self._agent,
            session=row.session,
            is_gap=row.is_gap,
            first_seq=row.first_seq,
            last_seq=row.last_seq,
            camera_hash=row.camera_hash,
            code=answer.code,
            reason=answer.reason,
            refused_at=now_text(self._machine.now_ns()),
        )
        with _spool_errors(self._letters.folder):
            self._letters.put(letter, row.payload)


@contextmanager
def _spool_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except (sqlite3.Error, OSError) as error:
        is_full = getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_FULL
        raise (_DiskFull if is_full else SpoolError)(f"{path}: {error}") from error
