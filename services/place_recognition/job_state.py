"""A job in the dispatcher's hands, and what follows from a change for the bus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from covinz.types import (
    JobRecord,
    JobState,
    Lease,
    LoopClosure,
    LoopJob,
    Outcome,
    Rejection,
)

Asker = TypeVar("Asker")


@dataclass(slots=True, eq=False)
class Job:
    """A job and what became of it so far.

    Attributes:
        number: In order of creation.
        job: What is asked.
        state: Where it is.
        failures: Leases that ended with the loss of their worker, or too late.
        outcome: Once there is one.
    """

    number: int
    job: LoopJob
    state: JobState
    failures: int
    outcome: Outcome | None

    @property
    def record(self) -> JobRecord:
        """As viewers see it."""
        is_lent = self.state in (JobState.LEASED, JobState.DONE)
        return JobRecord(self.job, self.state, self.failures + is_lent, self.outcome)


@dataclass(frozen=True, slots=True, eq=False)
class Effects(Generic[Asker]):
    """What the owner has to do after the journal is committed.

    Attributes:
        granted: Askers that get a lease.
        turned_away: Askers whose request ends without one.
        dead: Jobs whose workers all failed, given up just now.
        shed: Why jobs were given up just now because too many waited.
    """

    granted: tuple[tuple[Asker, Lease], ...]
    turned_away: tuple[Asker, ...]
    dead: tuple[tuple[LoopJob, Rejection], ...]
    shed: tuple[Rejection, ...]


def given_up(entry: Job, stage: str, count: int, limit: int, detail: str) -> Rejection:
    """The outcome of a job that nobody solved."""
    job = entry.job
    return Rejection(
        job_id=job.id,
        query=job.query,
        cand=job.cand,
        stage=stage,
        count=count,
        threshold=limit,
        detail=detail,
        solver_ms=0.0,
    )


def counter_of(outcome: Outcome) -> str:
    """``accepted`` or ``rejected.<stage>``."""
    return "accepted" if isinstance(outcome, LoopClosure) else f"rejected.{outcome.stage}"
