"""What is in a spool file: tables, rows, and gaps in the place of keyframes that were dropped."""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Collection
from dataclasses import dataclass, field

from covinz import codec
from covinz.durable import FileKind
from covinz.types import Gap, KeyframeId


def _upgrade_1(db: sqlite3.Connection) -> None:
    """Format 1 knew no ages, times and checksums; what it kept of refusals stays in its table."""
    for column in ("clock_s REAL", "dropped INTEGER", "rejected INTEGER"):
        db.execute(f"ALTER TABLE owner ADD COLUMN {column} NOT NULL DEFAULT 0")
    db.execute("ALTER TABLE session ADD COLUMN last_stamp_ns INTEGER NOT NULL DEFAULT 0")
    for column in ("spooled_s REAL", "crc INTEGER"):
        db.execute(f"ALTER TABLE outbox ADD COLUMN {column} NOT NULL DEFAULT 0")
    for (position,) in db.execute("SELECT position FROM outbox").fetchall():
        one = "SELECT payload FROM outbox WHERE position = ?"
        (payload,) = db.execute(one, (position,)).fetchone()
        crc = zlib.crc32(payload)
        db.execute("UPDATE outbox SET crc = ? WHERE position = ?", (crc, position))
    db.execute("UPDATE owner SET rejected = (SELECT COUNT(*) FROM rejected WHERE NOT is_gap)")
    db.execute("CREATE INDEX gap_end ON outbox (session, last_seq) WHERE is_gap")
    db.execute("CREATE INDEX gap_begin ON outbox (session, first_seq) WHERE is_gap")


# `spooled_s` is in the spool's own time, which `owner.clock_s` carries from run to run.
SPOOL_FILE = FileKind(
    name="keyframe spool",
    application_id=b"cvzS",
    version=2,
    schema="""
    CREATE TABLE owner (
        agent TEXT NOT NULL,
        clock_s REAL NOT NULL DEFAULT 0,
        dropped INTEGER NOT NULL DEFAULT 0,
        rejected INTEGER NOT NULL DEFAULT 0
    );
    CREATE TABLE session (
        session TEXT PRIMARY KEY, next_seq INTEGER NOT NULL, last_stamp_ns INTEGER NOT NULL
    );
    CREATE TABLE camera (hash TEXT PRIMARY KEY, payload BLOB NOT NULL);
    CREATE TABLE outbox (
        position INTEGER PRIMARY KEY AUTOINCREMENT,
        session TEXT NOT NULL,
        is_gap INTEGER NOT NULL,
        first_seq INTEGER NOT NULL,
        last_seq INTEGER NOT NULL,
        camera_hash TEXT NOT NULL,
        reason TEXT NOT NULL DEFAULT '',
        spooled_s REAL NOT NULL,
        crc INTEGER NOT NULL,
        payload BLOB NOT NULL
    );
    CREATE INDEX gap_end ON outbox (session, last_seq) WHERE is_gap;
    CREATE INDEX gap_begin ON outbox (session, first_seq) WHERE is_gap;
    """,
    upgrades=(_upgrade_1,),
)
# The log beside the file is brought into it when it has so many pages: 0.5 MiB.
CHECKPOINT_PAGES = 128
# What is written in one commit should not be larger than this. [bytes]
BATCH_BYTES = 256 * 1024
# More than that log grows to: enough to delete when the disk is full. [bytes]
RESERVE_BYTES = 1024 * 1024
# Reasons of gaps.
FULL = "spool full"
TOO_OLD = "too old"
DAMAGED = "damaged on the robot's disk"
_COLUMNS = (
    "position, session, is_gap, first_seq, last_seq, camera_hash, reason, spooled_s, crc, payload"
)
_TYPES = [int, str, int, int, int, str, str, float, int, bytes]


@dataclass(frozen=True, slots=True)
class SpoolEntry:
    """A keyframe for the spool.

    Attributes:
        id: Its name.
        stamp_ns: Its time.
        payload: The message.
        camera_hash: Its calibration.
        camera_payload: The message of that.
    """

    id: KeyframeId
    stamp_ns: int
    payload: bytes = field(repr=False)
    camera_hash: str
    camera_payload: bytes = field(repr=False)


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
        reason: Of a gap; empty for a keyframe.
        spooled_s: When it came, in the spool's own time.
        crc: Checksum of the payload when it was written.
        payload: The message.
    """

    position: int
    session: str
    is_gap: bool
    first_seq: int
    last_seq: int
    camera_hash: str
    reason: str
    spooled_s: float
    crc: int
    payload: bytes = field(repr=False)

    @property
    def count(self) -> int:
        """Number of keyframes that it stands for."""
        return self.last_seq - self.first_seq + 1

    @property
    def is_damaged(self) -> bool:
        """The disk does not give back what was written."""
        return zlib.crc32(self.payload) != self.crc


def insert(db: sqlite3.Connection, entry: SpoolEntry, spooled_s: float) -> int:
    """Put a keyframe at the end; returns its position."""
    kf = entry.id
    db.execute(
        "INSERT INTO camera VALUES (?, ?) ON CONFLICT DO NOTHING",
        (entry.camera_hash, entry.camera_payload),
    )
    db.execute(
        "INSERT INTO session VALUES (?, ?, ?) ON CONFLICT (session) DO UPDATE"
        " SET next_seq = excluded.next_seq, last_stamp_ns = excluded.last_stamp_ns",
        (kf.session, kf.seq + 1, entry.stamp_ns),
    )
    return insert_again(db, kf, entry.camera_hash, entry.payload, spooled_s)


def insert_again(
    db: sqlite3.Connection, kf: KeyframeId, camera_hash: str, payload: bytes, spooled_s: float
) -> int:
    """Put a keyframe of an earlier time at the end; returns its position."""
    position = db.execute(
        "INSERT INTO outbox (session, is_gap, first_seq, last_seq, camera_hash, spooled_s, crc,"
        " payload) VALUES (?, 0, ?, ?, ?, ?, ?, ?)",
        (kf.session, kf.seq, kf.seq, camera_hash, spooled_s, zlib.crc32(payload), payload),
    ).lastrowid
    assert position is not None
    return position


def row_at(db: sqlite3.Connection, position: int) -> SpoolRow:
    """The row at a position."""
    row = _first(db, "position = ?", (position,))
    assert row is not None
    return row


def oldest(db: sqlite3.Connection, skip: Collection[int]) -> SpoolRow | None:
    """The oldest row whose position is not in `skip`."""
    return _first(db, f"position NOT IN ({_marks(skip)})", tuple(skip))


def oldest_keyframe(
    db: sqlite3.Connection, skip: Collection[int], before: int = 2**63 - 1
) -> SpoolRow | None:
    """The oldest keyframe at a position below `before` that is not in `skip`."""
    where = f"NOT is_gap AND position < ? AND position NOT IN ({_marks(skip)})"
    return _first(db, where, (before, *skip))


def delete(db: sqlite3.Connection, position: int) -> None:
    """Forget a row."""
    db.execute("DELETE FROM outbox WHERE position = ?", (position,))


@dataclass(frozen=True, slots=True)
class PutGap:
    """What became of the spool when a gap came into it.

    Attributes:
        gap: The gap, which may have grown out of others.
        more_rows: By how many rows the spool grew: 0, or less where gaps became one.
        more_bytes: By how many bytes.
    """

    gap: SpoolRow
    more_rows: int
    more_bytes: int


def put_gap(
    db: sqlite3.Connection, agent: str, row: SpoolRow, reason: str, fixed: Collection[int]
) -> PutGap:
    """Put a gap in the place of a keyframe, as one with the gaps of that reason right beside it.

    Args:
        db: In a transaction.
        agent: Whose spool it is.
        row: The keyframe.
        reason: Why it is not sent.
        fixed: Positions of gaps that may have been sent: they must stay as they are.
    """
    sides = (("last_seq", row.first_seq - 1), ("first_seq", row.last_seq + 1))
    rows = [row]
    for column, seq in sides:
        beside = _first(
            db,
            f"is_gap AND session = ? AND {column} = ? AND reason = ?"
            f" AND position NOT IN ({_marks(fixed)})",
            (row.session, seq, reason, *fixed),
        )
        if beside is not None:
            rows.append(beside)
    place, *others = sorted(rows, key=lambda one: one.position)
    for other in others:
        delete(db, other.position)
    first, last = min(one.first_seq for one in rows), max(one.last_seq for one in rows)
    gap = write_gap(db, agent, place, first, last, reason)
    before = sum(len(one.payload) for one in rows)
    return PutGap(gap, -len(others), len(gap.payload) - before)


def write_gap(
    db: sqlite3.Connection, agent: str, place: SpoolRow, first: int, last: int, reason: str
) -> SpoolRow:
    """Turn a row into this gap."""
    payload = codec.encode(Gap(agent, place.session, first, last, reason))
    db.execute(
        "UPDATE outbox SET is_gap = 1, first_seq = ?, last_seq = ?, reason = ?,"
        " camera_hash = '', crc = ?, payload = ? WHERE position = ?",
        (first, last, reason, zlib.crc32(payload), payload, place.position),
    )
    return row_at(db, place.position)


def usage(db: sqlite3.Connection) -> tuple[int, int]:
    """Number of rows, and bytes of their payloads."""
    size = "COALESCE(SUM(length(payload)), 0)"
    count, size_bytes = db.execute(f"SELECT COUNT(*), {size} FROM outbox").fetchone()
    return count, size_bytes


def _first(db: sqlite3.Connection, where: str, values: tuple[object, ...]) -> SpoolRow | None:
    row = db.execute(
        f"SELECT {_COLUMNS} FROM outbox WHERE {where} ORDER BY position LIMIT 1", values
    ).fetchone()
    if row is None:
        return None
    if [type(value) for value in row] != _TYPES:
        raise sqlite3.DatabaseError(f"row {row[0]} is damaged")
    position, session, is_gap, *rest = row
    return SpoolRow(position, session, bool(is_gap), *rest)


def _marks(values: Collection[int]) -> str:
    return ", ".join("?" * len(values))
