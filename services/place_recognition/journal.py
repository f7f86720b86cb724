"""The durable memory of jobs: failures and outcomes by job id, for one keyframe log.

Jobs themselves are not here: they are made again from the log. What the journal holds for a job
that does not exist yet, or no longer under a changed configuration, waits until it does.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from covinz import codec
from covinz.durable import DurableFile, FileKind
from covinz.types import JobState, LoopClosure, Outcome

KIND = FileKind(
    name="job journal",
    application_id=b"cvzJ",
    version=1,
    schema="""
    CREATE TABLE log (only INTEGER PRIMARY KEY CHECK (only = 0), log_id TEXT NOT NULL);
    INSERT INTO log VALUES (0, '');
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
    """Writes are one transaction until `commit`, which makes them durable together.

    Raises:
        DurableFileError: If the file cannot be used.
    """

    def __init__(self, path: Path) -> None:
        self._file = DurableFile(path, KIND)
        self._db = self._file.db

    @property
    def log_id(self) -> str:
        """The log that the jobs belong to; empty at first."""
        (log_id,) = self._db.execute("SELECT log_id FROM log").fetchone()
        return str(log_id)

    def adopt(self, log_id: str) -> None:
        """Remember jobs of this log from now on; those of another log are forgotten."""
        if log_id != self.log_id:
            self._begin()
            self._db.execute("DELETE FROM job")
            self._db.execute("UPDATE log SET log_id = ?", (log_id,))

    def recall(self, job_id: str) -> Memory:
        """What is known of a job."""
        row = self._db.execute(
            "SELECT attempts, state, outcome FROM job WHERE id = ?", (job_id,)
        ).fetchone()
        if row is None:
            return Memory()
        failures, state, outcome = row
        if state is None:
            return Memory(failures)
        return Memory(failures, JobState(state), codec.decode_outcome(outcome))

    def note_failures(self, job_id: str, failures: int) -> None:
        """A job has failed so many times."""
        self._begin()
        self._db.execute(
            "INSERT INTO job (id, attempts) VALUES (?, ?)"
            " ON CONFLICT (id) DO UPDATE SET attempts = excluded.attempts",
            (job_id, failures),
        )

    def forget(self, job_id: str) -> None:
        """A job is to be done anew."""
        self._begin()
        self._db.execute("DELETE FROM job WHERE id = ?", (job_id,))

    def note_outcome(self, outcome: Outcome, state: JobState) -> None:
        """A job is DONE or DEAD with this outcome."""
        self._begin()
        kind = "loop" if isinstance(outcome, LoopClosure) else "rejection"
        self._db.execute(
            "INSERT INTO job (id, attempts, state, kind, outcome) VALUES (?, 0, ?, ?, ?)"
            " ON CONFLICT (id) DO UPDATE"
            " SET state = excluded.state, kind = excluded.kind, outcome = excluded.outcome",
            (outcome.job_id, state.value, kind, codec.encode(outcome)),
        )

    def commit(self) -> None:
        """Make everything noted so far durable."""
        if self._db.in_transaction:
            self._db.execute("COMMIT")

    def close(self) -> None:
        """Close the file; what was not committed is lost."""
        self._file.close()

    def _begin(self) -> None:
        if not self._db.in_transaction:
            self._db.execute("BEGIN IMMEDIATE")
