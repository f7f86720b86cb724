"""The durable memory of jobs: failures and outcomes by job id, for one keyframe log.

Jobs themselves are not here: they are made again from the log. What the journal holds for a job
that does not exist yet, or no longer under a changed configuration, waits until it does.
"""

from __future__ import annotations

import logging
import sqlite3
from dataclasses import dataclass
from pathlib import Path

from covinz import codec
from covinz.damage import CommitFailed, Trouble
from covinz.durable import DamagedFile, DurableFile, FileKind
from covinz.types import JobState, LogMark, LoopClosure, Outcome

logger = logging.getLogger(__name__)

# Loops in one answer; one is about 2 kB.
PAGE_LOOPS = 256


def _upgrade_1(db: sqlite3.Connection) -> None:
    db.execute("ALTER TABLE log ADD COLUMN seen INTEGER NOT NULL DEFAULT 0")
    db.execute("ALTER TABLE log ADD COLUMN chain TEXT NOT NULL DEFAULT ''")


KIND = FileKind(
    name="job journal",
    application_id=b"cvzJ",
    version=2,
    upgrades=(_upgrade_1,),
    schema="""
    CREATE TABLE log (
        only INTEGER PRIMARY KEY CHECK (only = 0),
        log_id TEXT NOT NULL,
        seen INTEGER NOT NULL,  -- entries of the log that are known
        chain TEXT NOT NULL     -- hash over them
    );
    INSERT INTO log VALUES (0, '', 0, '');
    CREATE TABLE job (
        id TEXT PRIMARY KEY,
        attempts INTEGER NOT NULL,     -- that failed
        state TEXT,     -- 'done' or 'dead'; NULL while there is no outcome
        kind TEXT,      -- of the outcome: 'loop' or 'rejection'
        outcome BLOB    -- as it came over the wire
    ) WITHOUT ROWID;
    """,
)


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What is known of a job from before.

    Attributes:
        failures: Leases so far that ended with the loss of their worker, or too late.
        state: PENDING, or DONE or DEAD with an outcome.
        outcome: Result of the job.
    """

    failures: int = 0
    state: JobState = JobState.PENDING
    outcome: Outcome | None = None


class Journal:
    """What is noted counts at once, and is durable after the next `commit` that succeeds.

    Raises:
        DamagedFile: If the file is damaged; also from `commit` and `recall`.
        DurableFileError: If the file cannot be used.
    """

    def __init__(self, path: Path) -> None:
        self._file = DurableFile(path, KIND)
        row = self._file.db.execute("SELECT log_id, seen, chain FROM log").fetchone()
        self._seen = LogMark(*row)
        # Noted and not committed: the statements in order, and what they say of each job.
        self._todo: list[tuple[str, tuple[object, ...]]] = []
        self._noted: dict[str, Memory] = {}
        self._is_other_log = False  # what the file holds is of a log that is forgotten

    @property
    def log_id(self) -> str:
        """The log that the jobs belong to; empty at first."""
        return self._seen.log_id

    @property
    def seen(self) -> LogMark:
        """How much of the log was known when something was noted last."""
        return self._seen

    def note_seen(self, mark: LogMark) -> None:
        """More of the log is known; durable together with the next job that is noted."""
        if mark.log_id == self.log_id and mark.index > self._seen.index:  # else it is read again
            self._seen = mark

    def adopt(self, log_id: str) -> None:
        """Remember jobs of this log from now on; those of another log are forgotten."""
        if log_id != self._seen.log_id:
            self._seen, self._is_other_log = LogMark(log_id), True
            self._noted.clear()
            self._todo = [("DELETE FROM job", ())]

    def recall(self, job_id: str) -> Memory:
        """What is known of a job."""
        if (noted := self._noted.get(job_id)) is not None:
            return noted
        if self._is_other_log:
            return Memory()
        try:
            row = self._file.db.execute(
                "SELECT attempts, state, outcome FROM job WHERE id = ?", (job_id,)
            ).fetchone()
        except sqlite3.DatabaseError as error:
            raise DamagedFile(f"{self._file.path}: job {job_id}: {error}") from error
        if row is None:
            return Memory()
        failures, state, outcome = row
        if state is None:
            return Memory(failures)
        try:
            return Memory(failures, JobState(state), codec.decode_outcome(outcome))
        except ValueError as error:
            logger.error("job %s is done again: its outcome is damaged: %s", job_id, error)
            return Memory()

    def loops(self, after: str) -> list[LoopClosure]:
        """Accepted loops that are durable, by job id, from the one after `after` on; some."""
        if self._is_other_log:
            return []
        try:
            rows = self._file.db.execute(
                "SELECT id, outcome FROM job WHERE kind = 'loop' AND id > ? ORDER BY id LIMIT ?",
                (after, PAGE_LOOPS),
            ).fetchall()
        except sqlite3.DatabaseError as error:
            raise DamagedFile(f"{self._file.path}: {error}") from error
        return [codec.decode(outcome, LoopClosure) for _, outcome in rows]

    def note_failures(self, job_id: str, failures: int) -> None:
        """A job has failed so many times."""
        known = self.recall(job_id)
        self._noted[job_id] = Memory(failures, known.state, known.outcome)
        self._todo.append(
            (
                "INSERT INTO job (id, attempts) VALUES (?, ?)"
                " ON CONFLICT (id) DO UPDATE SET attempts = excluded.attempts",
                (job_id, failures),
            )
        )

    def forget(self, job_id: str) -> None:
        """A job is to be done anew."""
        self._noted[job_id] = Memory()
        self._todo.append(("DELETE FROM job WHERE id = ?", (job_id,)))

    def note_outcome(self, outcome: Outcome, state: JobState) -> None:
        """A job is DONE or DEAD with this outcome."""
        failures = self.recall(outcome.job_id).failures
        self._noted[outcome.job_id] = Memory(failures, state, outcome)
        kind = "loop" if isinstance(outcome, LoopClosure) else "rejection"
        self._todo.append(
            (
                "INSERT INTO job (id, attempts, state, kind, outcome) VALUES (?, 0, ?, ?, ?)"
                " ON CONFLICT (id) DO UPDATE"
                " SET state = excluded.state, kind = excluded.kind, outcome = excluded.outcome",
                (outcome.job_id, state.value, kind, codec.encode(outcome)),
            )
        )

    def commit(self) -> None:
        """Make everything noted so far durable.

        Raises:
            CommitFailed: If it could not be stored; it stays noted, for the next commit.
        """
        if not self._todo:
            return
        try:
            with self._file.transaction() as db:
                for statement, values in self._todo:
                    db.execute(statement, values)
                mark = (self._seen.log_id, self._seen.index, self._seen.chain)
                db.execute("UPDATE log SET log_id = ?, seen = ?, chain = ?", mark)
        except sqlite3.Error as error:
            if Trouble.of(error) is Trouble.DAMAGED:
                raise DamagedFile(f"{self._file.path}: {error}") from error
            raise CommitFailed(self._file.path, error) from error
        self._todo.clear()
        self._noted.clear()
        self._is_other_log = False

    def close(self) -> None:
        """Close the file; what was not committed is lost."""
        self._file.close()
