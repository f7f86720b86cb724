"""The keyframe log: every admitted upload once, durable, numbered without gaps.

One thread owns it and commits uploads in groups; `log_reader` reads it from another.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from covinz import codec
from covinz.damage import CommitFailed
from covinz.durable import DamagedFile, DurableFile, FileKind
from covinz.machine import THIS_MACHINE, Machine
from covinz.types import Camera, Duplicate, Gap, Keyframe, Rejected, Stored
from covinz.ulid import new_ulid
from services.ingest.admission import AdmittedCamera, AdmittedUpload, Code
from services.ingest.history import NO_CHAIN, chain_at, chained, digest_of
from services.ingest.retained import Retained

# What version 1 did not have.
_SINCE_2 = """
    -- Hash over all entries up to and with this one: equal chains mean equal histories.
    CREATE TABLE chain (log_index INTEGER PRIMARY KEY, value BLOB NOT NULL);
    CREATE TABLE retention (
        only INTEGER PRIMARY KEY CHECK (only = 0),
        features_from INTEGER NOT NULL,  -- entries before have no features any more
        running_s REAL NOT NULL          -- how long ingest ran in all, while ages counted
    );
    INSERT INTO retention VALUES (0, 0, 0.0);
    -- At `running_s` the log had `head` entries.
    CREATE TABLE age (head INTEGER PRIMARY KEY, running_s REAL NOT NULL);
"""


def _upgrade_1(db: sqlite3.Connection) -> None:
    for statement in _SINCE_2.split(";\n"):
        db.execute(statement)
    chain = NO_CHAIN
    for log_index, digest in db.execute("SELECT log_index, digest FROM entry ORDER BY log_index"):
        chain = chained(chain, digest)
        db.execute("INSERT INTO chain VALUES (?, ?)", (log_index, chain))


# Big columns come last: SQLite reads a row only as far as it must, so a scan of the poses does
# not touch the features. Of entries without features the payload is empty.
LOG_FILE = FileKind(
    name="keyframe log",
    application_id=b"cvzL",
    version=2,
    upgrades=(_upgrade_1,),
    schema=_SINCE_2
    + """
    CREATE TABLE identity (log_id TEXT NOT NULL);
    CREATE TABLE entry (
        log_index INTEGER PRIMARY KEY,
        agent TEXT NOT NULL,
        session TEXT NOT NULL,
        is_gap INTEGER NOT NULL,
        first_seq INTEGER NOT NULL,
        last_seq INTEGER NOT NULL,
        digest BLOB NOT NULL,
        pose BLOB NOT NULL,
        payload BLOB NOT NULL
    );
    CREATE UNIQUE INDEX entry_id ON entry (agent, session, is_gap, first_seq);
    CREATE TABLE camera (hash TEXT PRIMARY KEY, agent TEXT NOT NULL, payload BLOB NOT NULL);
    """,
)


class LogUnavailable(CommitFailed):
    """Nothing could be stored; the log is as it was before."""


@dataclass(frozen=True, slots=True)
class AgentTotals:
    """What the log holds of one agent."""

    keyframes: int = 0
    payload_bytes: int = 0
    gaps: int = 0
    dropped_keyframes: int = 0


class KeyframeLog:
    """The writing side of the log, for one thread.

    Args:
        path: SQLite file; made when it is not there, with a new identity.
        busy_timeout_s: How long a commit waits for another connection before it fails.
        machine: Clock and chance, for the identity.

    Raises:
        DurableFileError: If the file is in use, damaged, or of another kind or version.
    """

    def __init__(
        self, path: Path, busy_timeout_s: float = 5.0, machine: Machine = THIS_MACHINE
    ) -> None:
        self._file = DurableFile(path, LOG_FILE, busy_timeout_s)
        self._machine = machine
        try:
            self.log_id = self._identity()
            self._head = _count(self._file.db)
            self._chain = self._stored_chain(self._head)
            self.retained = Retained(self._file)
            self._cameras = dict(self._stored_cameras())
        except (sqlite3.Error, codec.MalformedMessage) as error:
            self._file.close()
            raise DamagedFile(
                f"{path}: the keyframe log is damaged: {error}. Restore a backup (covinz restore)"
            ) from error

    @property
    def head(self) -> int:
        """Number of entries: the next log_index to be given."""
        return self._head

    @property
    def cameras(self) -> Mapping[str, Camera]:
        """Registered calibrations by hash."""
        return MappingProxyType(self._cameras)

    def append(
        self, batch: Sequence[AdmittedUpload | AdmittedCamera]
    ) -> list[Stored | Duplicate | Rejected]:
        """Make all of `batch` durable in one commit; one answer each, in order.

        Raises:
            LogUnavailable: If nothing of it could be stored.
        """
        answers: list[Stored | Duplicate | Rejected] = []
        try:
            with self._file.transaction() as db:
                head = _count(db)
                chain = self._chain if head == self._head else self._stored_chain(head)
                for record in batch:
                    if isinstance(record, AdmittedCamera):
                        answers.append(_put_camera(db, record))
                        continue
                    digest = digest_of(record.payload)
                    answers.append(_put_entry(db, head, record, digest))
                    if isinstance(answers[-1], Stored):
                        chain = chained(chain, digest)
                        db.execute("INSERT INTO chain VALUES (?, ?)", (head, chain))
                        head += 1
        except sqlite3.Error as error:
            raise LogUnavailable(self._file.path, error) from error
        self._head, self._chain = head, chain
        for record in batch:
            if isinstance(record, AdmittedCamera):
                self._cameras[record.camera.hash] = record.camera
        return answers

    def begin_history(self) -> str:
        """Become another log, whose readers begin anew; returns the new identity.

        Raises:
            LogUnavailable: If it could not be stored.
        """
        log_id = new_ulid(self._machine)
        try:
            with self._file.transaction() as db:
                db.execute("UPDATE identity SET log_id = ?", (log_id,))
        except sqlite3.Error as error:
            raise LogUnavailable(self._file.path, error) from error
        self.log_id = log_id
        return log_id

    def totals(self) -> dict[str, AgentTotals]:
        """What the log holds of each agent."""
        rows = self._file.db.execute(
            "SELECT agent, SUM(NOT is_gap), SUM(length(payload)), SUM(is_gap),"
            " SUM(is_gap * (last_seq - first_seq + 1)) FROM entry GROUP BY agent"
        )
        return {agent: AgentTotals(*counts) for agent, *counts in rows}

    def camera_counts(self) -> dict[str, int]:
        """Number of calibrations that each agent has registered."""
        return dict(self._file.db.execute("SELECT agent, COUNT(*) FROM camera GROUP BY agent"))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _identity(self) -> str:
        with self._file.transaction() as db:
            row = db.execute("SELECT log_id FROM identity").fetchone()
            if row is None:
                row = (new_ulid(self._machine),)
                db.execute("INSERT INTO identity VALUES (?)", row)
        return str(row[0])

    def _stored_chain(self, head: int) -> bytes:
        chain = chain_at(self._file.db, head)
        if chain is None:
            raise sqlite3.DatabaseError(f"no hash of the first {head} entries")
        return chain

    def _stored_cameras(self) -> Iterator[tuple[str, Camera]]:
        for name, payload in self._file.db.execute("SELECT hash, payload FROM camera"):
            yield name, codec.decode(payload, Camera)


def _count(db: sqlite3.Connection) -> int:
    return int(db.execute("SELECT COALESCE(MAX(log_index) + 1, 0) FROM entry").fetchone()[0])


def _put_entry(
    db: sqlite3.Connection, log_index: int, record: AdmittedUpload, digest: bytes
) -> Stored | Duplicate | Rejected:
    name, last_seq = _name(record.item)
    row = db.execute(
        "SELECT digest FROM entry WHERE agent = ? AND session = ? AND is_gap = ? AND first_seq = ?",
        name,
    ).fetchone()
    if row is not None and row[0] == digest:
        return Duplicate()
    if row is not None:
        return Rejected(Code.CONFLICT.value, "the log holds other content under this id")
    db.execute(
        "INSERT INTO entry VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
        (log_index, *name, last_seq, digest, record.pose, record.payload),
    )
    return Stored()


def _name(item: Keyframe | Gap) -> tuple[tuple[str, str, bool, int], int]:
    """The columns that identify an entry, and the last sequence number it covers."""
    if isinstance(item, Gap):
        return (item.agent, item.session, True, item.first_seq), item.last_seq
    kf = item.id
    return (kf.agent, kf.session, False, kf.seq), kf.seq


def _put_camera(db: sqlite3.Connection, record: AdmittedCamera) -> Stored | Duplicate:
    inserted = db.execute(
        "INSERT INTO camera VALUES (?, ?, ?) ON CONFLICT (hash) DO NOTHING",
        (record.camera.hash, record.agent, record.payload),
    ).rowcount
    return Stored() if inserted else Duplicate()
