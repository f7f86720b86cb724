"""What the optimizer must not lose: accepted loops, map revision, last corrections."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from covinz import codec
from covinz.durable import DurableFile, FileKind
from covinz.types import Correction, LoopClosure
from services.optimizer.optimisation import Fault

KIND = FileKind(
    name="loop store",
    application_id=b"cvzO",
    version=1,
    schema="""
    CREATE TABLE log (
        only INTEGER PRIMARY KEY CHECK (only = 0),
        log_id TEXT NOT NULL,
        revision INTEGER NOT NULL
    );
    INSERT INTO log VALUES (0, '', 0);
    CREATE TABLE loop (
        job_id TEXT PRIMARY KEY,
        fault TEXT,     -- why it is left out of the maps; NULL: it is not
        payload BLOB NOT NULL
    ) WITHOUT ROWID;
    CREATE TABLE correction (agent TEXT PRIMARY KEY, payload BLOB NOT NULL) WITHOUT ROWID;
    """,
)


class StoreUnavailable(RuntimeError):
    """A commit failed (disk full, damaged); the store is as it was before."""


class LoopStore:
    """For one thread; every method that changes something is durable when it returns.

    Args:
        path: SQLite file; made when it is not there.

    Raises:
        DurableFileError: If the file is in use, damaged, or of another kind or version.
    """

    def __init__(self, path: Path) -> None:
        self._file = DurableFile(path, KIND)
        row = self._file.db.execute("SELECT log_id, revision FROM log").fetchone()
        self._log_id, self._revision = str(row[0]), int(row[1])

    @property
    def log_id(self) -> str:
        """Log that the loops belong to; empty before the first one is known."""
        return self._log_id

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
        return dict(rows)

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
        with self._commit() as db:
            db.executemany(
                "UPDATE loop SET fault = ? WHERE job_id = ?",
                [(fault.reason, fault.job_id) for fault in faults],
            )

    def begin_log(self, log_id: str) -> None:
        """Follow another log: forget loops and corrections.

        Raises:
            StoreUnavailable: If it could not be stored.
        """
        with self._commit() as db:
            db.execute("DELETE FROM loop")
            db.execute("DELETE FROM correction")
            db.execute("UPDATE log SET log_id = ?", (log_id,))
        self._log_id = log_id

    def publish(self, revision: int, corrections: Sequence[Correction]) -> None:
        """Remember what is about to be published; raises StoreUnavailable."""
        with self._commit() as db:
            db.execute("UPDATE log SET revision = ?", (revision,))
            db.executemany(
                "INSERT OR REPLACE INTO correction VALUES (?, ?)",
                [(c.keyframe.agent, codec.encode(c)) for c in corrections],
            )
        self._revision = revision

    def close(self) -> None:
        """Close the file and let others open it."""
        self._file.close()

    @contextmanager
    def _commit(self) -> Iterator[sqlite3.Connection]:
        try:
            with self._file.transaction() as db:
                yield db
        except sqlite3.Error as error:
            raise StoreUnavailable(f"{self._file.path}: {error}") from error
