"""The spool: keyframes that a robot has sent and the server has not acknowledged, on its disk."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from covinz import codec
from covinz.durable import DurableFile, DurableFileError, FileKind
from covinz.types import Gap, KeyframeId, Rejected

SPOOL_FILE = FileKind(
    name="keyframe spool",
    application_id=b"cvzS",
    version=1,
    schema="""
    CREATE TABLE owner (agent TEXT NOT NULL);
    CREATE TABLE session (session TEXT PRIMARY KEY, next_seq INTEGER NOT NULL);
    CREATE TABLE camera (hash TEXT PRIMARY KEY, payload BLOB NOT NULL);
    CREATE TABLE outbox (
        position INTEGER PRIMARY KEY AUTOINCREMENT,
        session TEXT NOT NULL,
        is_gap INTEGER NOT NULL,
        first_seq INTEGER NOT NULL,
        last_seq INTEGER NOT NULL,
        camera_hash TEXT NOT NULL,
        reason TEXT NOT NULL DEFAULT '',
        payload BLOB NOT NULL
    );
    CREATE TABLE rejected (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        session TEXT NOT NULL,
        is_gap INTEGER NOT NULL,
        first_seq INTEGER NOT NULL,
        last_seq INTEGER NOT NULL,
        code TEXT NOT NULL,
        reason TEXT NOT NULL,
        payload BLOB NOT NULL
    );
    """,
)
FULL = "spool full"  # reason of a gap
_COLUMNS = "position, session, is_gap, first_seq, last_seq, camera_hash, payload"


class SpoolError(RuntimeError):
    """The spool cannot be used: disk full, damaged, another agent's, or in use."""


@dataclass(frozen=True, slots=True)
class SpoolRow:
    """One upload that waits.

    Attributes:
        position: Rows are uploaded in this order.
        session: Session of the keyframe or gap.
        is_gap: Whether it is a gap.
        first_seq: The keyframe, or the first of the gap.
        last_seq: The same, or the last of the gap.
        camera_hash: Calibration of the keyframe; empty for a gap.
        payload: The message.
    """

    position: int
    session: str
    is_gap: bool
    first_seq: int
    last_seq: int
    camera_hash: str
    payload: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class RejectedRow:
    """One upload that the server refused for good."""

    session: str
    is_gap: bool
    first_seq: int
    last_seq: int
    code: str
    reason: str


class Spool:
    """Uploads of one agent, of this run and of earlier ones; safe to use from several threads.

    A row that `take` hands out is in flight until `delivered`, `rejected` or `release`; nobody
    else gets it meanwhile. Beyond `max_bytes` the oldest keyframes that are not in flight make
    way for a gap that says so and is delivered in their place. (If only the acknowledgement of a
    dropped keyframe was lost, the log holds the keyframe as well as the gap.)

    Args:
        path: SQLite file; made when it is not there.
        agent: Whose keyframes they are.
        max_bytes: Payload beyond which the oldest keyframes are dropped.

    Raises:
        SpoolError: From every method.
    """

    def __init__(self, path: Path, agent: str, max_bytes: int) -> None:
        self._agent = agent
        self._max_bytes = max_bytes
        self._lock = threading.Lock()  # the connection and what follows
        self._in_flight: set[int] = set()
        try:
            self._file = DurableFile(path, SPOOL_FILE)
        except DurableFileError as error:
            raise SpoolError(str(error)) from error
        try:
            with _spool_errors(path):
                self._check_owner()
                self._count, self._bytes = self._usage()
                rows = self._file.db.execute("SELECT position FROM outbox WHERE is_gap")
                # A gap that may have been sent must not grow any more.
                self._sent_gaps = {position for (position,) in rows}
        except BaseException:
            self._file.close()
            raise

    def __len__(self) -> int:
        """Uploads that wait or are in flight."""
        with self._lock:
            return self._count

    def next_seq(self, session: str) -> int:
        """The number of the session's next keyframe."""
        with self._lock, _spool_errors(self._file.path):
            row = self._file.db.execute(
                "SELECT next_seq FROM session WHERE session = ?", (session,)
            ).fetchone()
        return int(row[0]) if row else 0

    def append(
        self, keyframe: KeyframeId, payload: bytes, camera_hash: str, camera_payload: bytes
    ) -> None:
        """Add a keyframe; it is on the disk when this returns."""
        with self._writing() as db:
            db.execute(
                "INSERT INTO camera VALUES (?, ?) ON CONFLICT DO NOTHING",
                (camera_hash, camera_payload),
            )
            db.execute(
                "INSERT INTO session VALUES (?, ?)"
                " ON CONFLICT (session) DO UPDATE SET next_seq = excluded.next_seq",
                (keyframe.session, keyframe.seq + 1),
            )
            newest = db.execute(
                "INSERT INTO outbox (session, is_gap, first_seq, last_seq, camera_hash, payload)"
                " VALUES (?, 0, ?, ?, ?, ?)",
                (keyframe.session, keyframe.seq, keyframe.seq, camera_hash, payload),
            ).lastrowid
            self._count += 1
            self._bytes += len(payload)
            while self._bytes > self._max_bytes and self._make_room(db, newest or 0):
                pass

    def take(self, later: Collection[int] = ()) -> SpoolRow | None:
        """The oldest upload that is not in flight, now in flight; None when there is none.

        Args:
            later: Positions that are taken only when there is nothing else.
        """
        with self._lock, _spool_errors(self._file.path):
            row = self._oldest({*self._in_flight, *later}) or self._oldest(self._in_flight)
            if row is None:
                return None
            self._in_flight.add(row.position)
            if row.is_gap:
                self._sent_gaps.add(row.position)
            return row

    def release(self, position: int) -> None:
        """The upload was not answered: it waits again."""
        with self._lock:
            self._in_flight.discard(position)

    def delivered(self, position: int) -> None:
        """The upload is durable at the server: forget it."""
        with self._writing(durable=False) as db:  # if the disk forgets this, it is sent twice
            self._delete(db, position)

    def rejected(self, position: int, answer: Rejected) -> None:
        """The server refused the upload for good: put it aside and declare a gap in its place.

        After a conflict there is no gap, for the log has a keyframe of this name; nor is there
        one for a gap.
        """
        with self._writing() as db:
            db.execute(
                "INSERT INTO rejected SELECT NULL, session, is_gap, first_seq, last_seq, ?, ?,"
                " payload FROM outbox WHERE position = ?",
                (answer.code, answer.reason, position),
            )
            row = _row(db, position)
            self._bytes += len(row.payload)
            if row.is_gap or answer.code == "conflict":
                self._delete(db, position)
            else:
                self._replace_by_gap(db, row, f"rejected: {answer.code}")

    def camera(self, camera_hash: str) -> bytes:
        """The Camera message of a spooled keyframe."""
        with self._lock, _spool_errors(self._file.path):
            row: tuple[bytes] = self._file.db.execute(
                "SELECT payload FROM camera WHERE hash = ?", (camera_hash,)
            ).fetchone()
        return row[0]

    def rejections(self) -> list[RejectedRow]:
        """What was refused for good and is still kept, oldest first."""
        with self._lock, _spool_errors(self._file.path):
            rows = self._file.db.execute(
                "SELECT session, is_gap, first_seq, last_seq, code, reason FROM rejected"
                " ORDER BY number"
            ).fetchall()
        return [RejectedRow(session, bool(is_gap), *rest) for session, is_gap, *rest in rows]

    def close(self) -> None:
        """Close the file; what waits is uploaded by whoever opens it next."""
        with self._lock:
            self._file.close()

    @contextmanager
    def _writing(self, durable: bool = True) -> Iterator[sqlite3.Connection]:
        """A transaction; the counters follow it when it fails."""
        with self._lock, _spool_errors(self._file.path):
            try:
                with self._file.transaction(durable) as db:
                    yield db
            except BaseException:
                self._count, self._bytes = self._usage()
                raise

    def _check_owner(self) -> None:
        with self._file.transaction() as db:
            row = db.execute("SELECT agent FROM owner").fetchone()
            if row is None:
                db.execute("INSERT INTO owner VALUES (?)", (self._agent,))
            elif row[0] != self._agent:
                raise SpoolError(f"{self._file.path} is the spool of agent {row[0]}")

    def _usage(self) -> tuple[int, int]:
        """Number of uploads that wait, and payload in the file."""
        size = "COALESCE(SUM(length(payload)), 0)"
        db = self._file.db
        count, waiting = db.execute(f"SELECT COUNT(*), {size} FROM outbox").fetchone()
        (refused,) = db.execute(f"SELECT {size} FROM rejected").fetchone()
        return count, waiting + refused

    def _oldest(self, skip: Collection[int]) -> SpoolRow | None:
        marks = ", ".join("?" * len(skip))
        row = self._file.db.execute(
            f"SELECT {_COLUMNS} FROM outbox WHERE position NOT IN ({marks})"
            " ORDER BY position LIMIT 1",
            tuple(skip),
        ).fetchone()
        return _spool_row(row) if row else None

    def _make_room(self, db: sqlite3.Connection, newest: int) -> bool:
        """Drop the oldest refused upload, or else the oldest keyframe before `newest`."""
        refused = db.execute(
            "SELECT number, length(payload) FROM rejected ORDER BY number LIMIT 1"
        ).fetchone()
        if refused is not None:
            db.execute("DELETE FROM rejected WHERE number = ?", (refused[0],))
            self._bytes -= refused[1]
            return True
        marks = ", ".join("?" * len(self._in_flight))
        oldest = db.execute(
            f"SELECT {_COLUMNS} FROM outbox WHERE NOT is_gap AND position < ?"
            f" AND position NOT IN ({marks}) ORDER BY position LIMIT 1",
            (newest, *self._in_flight),
        ).fetchone()
        if oldest is None:
            return False
        self._replace_by_gap(db, _spool_row(oldest), FULL)
        return True

    def _replace_by_gap(self, db: sqlite3.Connection, row: SpoolRow, reason: str) -> None:
        """Put a gap in the place of a keyframe, or let the gap just before it grow."""
        before = db.execute(
            f"SELECT {_COLUMNS} FROM outbox WHERE is_gap AND session = ? AND last_seq = ?"
            " AND reason = ?",
            (row.session, row.first_seq - 1, reason),
        ).fetchone()
        grown = _spool_row(before) if before else None
        if grown is None or grown.position in self._sent_gaps:
            self._put_gap(db, row, row.first_seq, row.last_seq, reason)
            self._in_flight.discard(row.position)
        else:
            self._put_gap(db, grown, grown.first_seq, row.last_seq, reason)
            self._delete(db, row.position)

    def _put_gap(
        self, db: sqlite3.Connection, place: SpoolRow, first: int, last: int, reason: str
    ) -> None:
        payload = codec.encode(Gap(self._agent, place.session, first, last, reason))
        db.execute(
            "UPDATE outbox SET is_gap = 1, first_seq = ?, last_seq = ?, reason = ?,"
            " camera_hash = '', payload = ? WHERE position = ?",
            (first, last, reason, payload, place.position),
        )
        self._bytes += len(payload) - len(place.payload)

    def _delete(self, db: sqlite3.Connection, position: int) -> None:
        row = _row(db, position)
        db.execute("DELETE FROM outbox WHERE position = ?", (position,))
        self._count -= 1
        self._bytes -= len(row.payload)
        self._in_flight.discard(position)
        self._sent_gaps.discard(position)


def _row(db: sqlite3.Connection, position: int) -> SpoolRow:
    row = db.execute(f"SELECT {_COLUMNS} FROM outbox WHERE position = ?", (position,)).fetchone()
    return _spool_row(row)


def _spool_row(values: tuple[Any, ...]) -> SpoolRow:
    position, session, is_gap, *rest = values
    return SpoolRow(position, session, bool(is_gap), *rest)


@contextmanager
def _spool_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise SpoolError(f"{path}: {error}") from error
