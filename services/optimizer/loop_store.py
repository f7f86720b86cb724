"""What the optimizer must not lose: accepted loops, map revision, last corrections."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from covinz import codec
from covinz.damage import CommitFailed, Trouble
from covinz.durable import DamagedFile, DurableFile, FileKind
from covinz.types import Correction, LogMark, LoopClosure
from services.optimizer.optimisation import Fault


def _upgrade_1(db: sqlite3.Connection) -> None:
    db.execute("ALTER TABLE log ADD COLUMN seen INTEGER NOT NULL DEFAULT 0")
    db.execute("ALTER TABLE log ADD COLUMN chain TEXT NOT NULL DEFAULT ''")


KIND = FileKind(
    name="loop store",
    application_id=b"cvzO",
    version=2,
    upgrades=(_upgrade_1,),
    schema="""
    CREATE TABLE log (
        only INTEGER PRIMARY KEY CHECK (only = 0),
        log_id TEXT NOT NULL,
        revision INTEGER NOT NULL,
        seen INTEGER NOT NULL,  -- entries of the log that are known
        chain TEXT NOT NULL     -- hash over them
    );
    INSERT INTO log VALUES (0, '', 0, 0, '');
    CREATE TABLE loop (
        job_id TEXT PRIMARY KEY,
        fault TEXT,     -- why it is left out of the maps; NULL: it is not
        payload BLOB NOT NULL
    ) WITHOUT ROWID;
    CREATE TABLE correction (agent TEXT PRIMARY KEY, payload BLOB NOT NULL) WITHOUT ROWID;
    """,
)


class StoreUnavailable(CommitFailed):
    """Nothing could be written now; the file is as it was before."""


class LoopStore:
    """For one thread; every method that changes something is durable when it returns.

    What `mark` and `publish` were told counts even if they raise: it is written with the next
    change that succeeds.

    Args:
        path: SQLite file; made when it is not there.

    Raises:
        DamagedFile: If the file is damaged; also from every method.
        DurableFileError: If the file is in use, or of another kind or version.
    """

    def __init__(self, path: Path) -> None:
        self._file = DurableFile(path, KIND)
        try:
            row = self._file.db.execute("SELECT log_id, seen, chain, revision FROM log").fetchone()
            self._seen, self._revision = LogMark(*row[:3]), int(row[3])
            self.loops(), self.corrections()
        except (sqlite3.Error, ValueError) as error:
            self._file.close()
            raise DamagedFile(f"{path}: the loop store is damaged: {error}") from error
        # Not written yet.
        self._faults: dict[str, str] = {}
        self._corrections: dict[str, bytes] = {}

    @property
    def log_id(self) -> str:
        """Log that the loops belong to; empty before the first one is known."""
        return self._seen.log_id

    @property
    def seen(self) -> LogMark:
        """How much of the log was known when something was written last."""
        return self._seen

    def note_seen(self, mark: LogMark) -> None:
        """More of the log is known; durable together with the next change."""
        if mark.log_id == self.log_id and mark.index > self._seen.index:  # else it is read again
            self._seen = mark

    @property
    def revision(self) -> int:
        """Number of optimisations so far, over all logs and restarts."""
        return self._revision

    def loops(self) -> list[LoopClosure]:
        """The loops that take part in maps, by job id."""
        rows = self._file.db.execute("SELECT payload FROM loop WHERE fault IS NULL ORDER BY job_id")
        return [codec.decode(payload, LoopClosure) for (payload,) in rows]

    def corrections(self) -> list[Correction]:
        """The last correction of every agent."""
        rows = self._file.db.execute("SELECT payload FROM correction ORDER BY agent")
        return [codec.decode(payload, Correction) for (payload,) in rows]

    def faults(self) -> dict[str, str]:
        """Reasons by job id of the loops that are left out."""
        rows = self._file.db.execute("SELECT job_id, fault FROM loop WHERE fault IS NOT NULL")
        return {**dict(rows), **self._faults}

    def add(self, loops: Sequence[tuple[str, bytes]]) -> list[bool]:
        """Store loops in one commit; for each, False when its job id was there already.

        Args:
            loops: Job id and LoopClosure as it came over the wire. Those very bytes are kept:
                encoded anew a pose may differ in its last bit, and so would the map.

        Raises:
            StoreUnavailable: If nothing of it could be stored.
        """
        with self._commit() as db:
            return [
                db.execute(
                    "INSERT OR IGNORE INTO loop VALUES (?, NULL, ?)",
                    (job_id, payload),
                ).rowcount
                == 1
                for job_id, payload in loops
            ]

    def mark(self, faults: Iterable[Fault]) -> None:
        """Leave loops out of the maps from now on; raises StoreUnavailable."""
        self._faults |= {fault.job_id: fault.reason for fault in faults}
        self.commit()

    def begin_log(self, log_id: str) -> None:
        """Follow another log: forget loops and corrections.

        Raises:
            StoreUnavailable: If it could not be stored.
        """
        with self._commit() as db:
            db.execute("DELETE FROM loop")
            db.execute("DELETE FROM correction")
            db.execute("UPDATE log SET log_id = ?, seen = 0, chain = ''", (log_id,))
        self._seen = LogMark(log_id)

    def publish(self, revision: int, corrections: Mapping[str, bytes]) -> None:
        """Remember what is about to be published, by agent; raises StoreUnavailable."""
        self._revision = revision
        self._corrections |= corrections
        self.commit()

    def commit(self) -> None:
        """Write what could not be written when it came; raises StoreUnavailable."""
        with self._commit():
            pass

    def close(self) -> None:
        """Close the file and let others open it."""
        self._file.close()

    @contextmanager
    def _commit(self) -> Iterator[sqlite3.Connection]:
        """A transaction that begins with what was not written yet."""
        try:
            with self._file.transaction() as db:
                db.execute(
                    "UPDATE log SET revision = ?, seen = ?, chain = ?",
                    (self._revision, self._seen.index, self._seen.chain),
                )
                db.executemany(
                    "INSERT OR REPLACE INTO correction VALUES (?, ?)", self._corrections.items()
                )
                db.executemany(
                    "UPDATE loop SET fault = ? WHERE job_id = ?",
                    [(reason, job_id) for job_id, reason in self._faults.items()],
                )
                yield db
        except sqlite3.Error as error:
            if Trouble.of(error) is Trouble.DAMAGED:
                raise DamagedFile(f"{self._file.path}: {error}") from error
            raise StoreUnavailable(self._file.path, error) from error
        self._faults.clear()
        self._corrections.clear()
