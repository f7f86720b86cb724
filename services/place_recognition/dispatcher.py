"""Lends jobs to workers and collects outcomes; knows neither clock nor bus.

pending -> leased -> done, or back to pending when a lease ends without an outcome, or dead after
too many. At-least-once execution, exactly-once effect: outcomes are deduplicated by job id.

Source: decision 0006 (pull with leases, liveliness as accelerator).
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass
from typing import Generic, TypeVar

from covinz.config import PlaceRecognitionConfig
from covinz.types import (
    JobPage,
    JobRecord,
    JobState,
    Lease,
    LoopClosure,
    LoopJob,
    Outcome,
    Rejected,
    Rejection,
    RetryAfter,
)
from services.place_recognition.journal import Journal

Asker = TypeVar("Asker")

# Job records in one answer; one is about 2 kB.
PAGE_RECORDS = 256
# What a worker is told to wait while the log is not known yet. [s]
RETRY_AFTER_S = 0.5


@dataclass(slots=True, eq=False)
class _Job:
    number: int
    job: LoopJob
    state: JobState
    attempts: int
    outcome: Outcome | None


@dataclass(frozen=True, slots=True, eq=False)
class _Loan:
    job: _Job
    until_s: float


@dataclass(frozen=True, slots=True, eq=False)
class _Waiter(Generic[Asker]):
    asker: Asker
    until_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Effects(Generic[Asker]):
    """What the owner has to do after the journal is committed.

    Attributes:
        granted: Askers that get a lease.
        turned_away: Askers whose request ends without one.
        dead: Jobs given up just now.
    """

    granted: tuple[tuple[Asker, Lease], ...]
    turned_away: tuple[Asker, ...]
    dead: tuple[Rejection, ...]


class Dispatcher(Generic[Asker]):
    """All jobs of one log and who works on them.

    A worker holds at most one lease and one open request: asking again ends both. A lease that
    ends so has not reached it, and is no attempt. Times are in seconds of one monotonic clock. An
    `Asker` is whatever stands for an open request.
    """

    def __init__(self, config: PlaceRecognitionConfig, journal: Journal) -> None:
        self._config = config
        self._journal = journal
        self._waiters: dict[str, _Waiter[Asker]] = {}
        self._gone: set[str] = set()
        self._turned_away: list[Asker] = []
        # Empty until it is known whether the journal's log is still the one.
        self._log_id = ""
        self._forget_jobs()

    def _forget_jobs(self) -> None:
        self._jobs: list[_Job] = []
        self._by_id: dict[str, _Job] = {}
        # Lowest number first, so a returned job goes to the front.
        self._pending: list[int] = []
        self._loans: dict[str, _Loan] = {}
        self._dead: list[Rejection] = []
        self._outcomes: Counter[str] = Counter()
        self._returned = 0

    @property
    def pending(self) -> int:
        """Jobs that wait for a worker."""
        return len(self._pending)

    @property
    def leased(self) -> int:
        """Jobs lent out."""
        return len(self._loans)

    @property
    def counters(self) -> dict[str, float]:
        """``accepted``, ``rejected.<stage>`` and ``returned`` (leases without an outcome)."""
        return {**self._outcomes, "returned": self._returned}

    def reset(self, log_id: str) -> None:
        """Forget all jobs: they are made again from log `log_id`; requests stay open."""
        self._journal.adopt(log_id)
        self._log_id = log_id
        self._forget_jobs()

    def add(self, job: LoopJob) -> None:
        """Take a new job in; its outcome may be known from before."""
        known = self._journal.recall(job.id)
        entry = _Job(len(self._jobs), job, known.state, known.attempts, known.outcome)
        self._jobs.append(entry)
        self._by_id[job.id] = entry
        if known.outcome is not None:
            self._outcomes[_counter(known.outcome)] += 1
        else:
            self._return(entry)

    def request(self, worker: str, asker: Asker, now_s: float) -> None:
        """A worker asks for a job; answered by `advance`, perhaps much later."""
        if worker in self._gone:
            # It died with this request on its way; one that lives will ask again.
            self._gone.discard(worker)
            self._turned_away.append(asker)
            return
        if worker in self._loans:
            self._undo_attempt(self._loans[worker].job)
        self._end_worker(worker)
        self._waiters[worker] = _Waiter(asker, now_s + self._config.long_poll_s)

    def worker_gone(self, worker: str) -> None:
        """The liveliness token of a worker vanished: its lease and its request end."""
        self._gone.add(worker)
        self._end_worker(worker)

    def objection(self, log_id: str) -> Rejected | RetryAfter | None:
        """Why an outcome of a job of log `log_id` is not taken; None when it is.

        Whoever lent the job knew its log from ingest. If that is not the one that is followed
        since, the log was lost meanwhile.
        """
        if log_id in ("", self._log_id):
            return None
        if self._log_id:
            return Rejected("other_log", f"the jobs are of log {self._log_id}, not {log_id}")
        if log_id == self._journal.log_id:
            return None
        return RetryAfter(RETRY_AFTER_S, "it is not known yet which log there is")

    def finish(self, outcome: Outcome) -> bool:
        """Take an outcome, whatever became of its lease; False when there was one before.

        A dead job comes back to life: its worker was only slow.
        """
        entry = self._by_id.get(outcome.job_id)
        state = entry.state if entry else self._journal.recall(outcome.job_id).state
        if state is JobState.DONE:
            return False
        if entry:
            self._settle(entry, outcome, JobState.DONE)
        else:
            # Of a job that comes again while the log is replayed.
            self._journal.note_outcome(outcome, JobState.DONE)
        return True

    def advance(self, now_s: float) -> Effects[Asker]:
        """End what is overdue and lend what can be lent: first come, first served."""
        for worker, loan in list(self._loans.items()):
            if loan.until_s <= now_s:
                self._end_loan(worker)
        granted = []
        while self._pending and self._waiters:
            worker = next(iter(self._waiters))
            waiter = self._waiters.pop(worker)
            granted.append((waiter.asker, self._lend(worker, now_s)))
        for worker, waiter in list(self._waiters.items()):
            if waiter.until_s <= now_s:
                self._turned_away.append(self._waiters.pop(worker).asker)
        effects = Effects(tuple(granted), tuple(self._turned_away), tuple(self._dead))
        self._turned_away, self._dead = [], []
        return effects

    def next_deadline_s(self) -> float | None:
        """When `advance` has something to do next, if nothing else happens."""
        loans = (loan.until_s for loan in self._loans.values())
        waiters = (waiter.until_s for waiter in self._waiters.values())
        return min((*loans, *waiters), default=None)

    def page(self, first: int) -> JobPage:
        """The jobs from number `first` on, in order of creation; at most `PAGE_RECORDS`."""
        records = tuple(
            JobRecord(entry.job, entry.state, entry.attempts, entry.outcome)
            for entry in self._jobs[first : first + PAGE_RECORDS]
        )
        return JobPage(total=len(self._jobs), first=first, records=records)

    def _lend(self, worker: str, now_s: float) -> Lease:
        entry = self._jobs[heapq.heappop(self._pending)]
        entry.state = JobState.LEASED
        entry.attempts += 1
        self._journal.note_attempt(entry.job.id, entry.attempts)
        self._loans[worker] = _Loan(entry, now_s + self._config.lease_s)
        return Lease(entry.job, worker, entry.attempts, self._config.lease_s, self._log_id)

    def _end_worker(self, worker: str) -> None:
        waiter = self._waiters.pop(worker, None)
        if waiter is not None:
            self._turned_away.append(waiter.asker)
        if worker in self._loans:
            self._end_loan(worker)

    def _undo_attempt(self, entry: _Job) -> None:
        """Nobody has touched the job; a link that loses leases must not use its attempts up."""
        entry.attempts -= 1
        self._journal.note_attempt(entry.job.id, entry.attempts)

    def _end_loan(self, worker: str) -> None:
        entry = self._loans.pop(worker).job
        self._returned += 1
        self._return(entry)

    def _return(self, entry: _Job) -> None:
        """Make a job without an outcome available, or give it up."""
        if entry.attempts < self._config.max_attempts:
            entry.state = JobState.PENDING
            heapq.heappush(self._pending, entry.number)
            return
        job = entry.job
        rejection = Rejection(
            job_id=job.id,
            query=job.query,
            cand=job.cand,
            stage="dead_letter",
            count=entry.attempts,
            threshold=self._config.max_attempts,
            detail="every worker that took the job failed to return an outcome",
            solver_ms=0.0,
        )
        self._settle(entry, rejection, JobState.DEAD)
        self._dead.append(rejection)

    def _settle(self, entry: _Job, outcome: Outcome, state: JobState) -> None:
        self._journal.note_outcome(outcome, state)
        if entry.state is JobState.PENDING and entry.number in self._pending:
            self._pending.remove(entry.number)
            heapq.heapify(self._pending)
        for worker, loan in list(self._loans.items()):
            if loan.job is entry:
                del self._loans[worker]
        if entry.outcome is not None:
            self._outcomes[_counter(entry.outcome)] -= 1
        self._outcomes[_counter(outcome)] += 1
        entry.state, entry.outcome = state, outcome


def _counter(outcome: Outcome) -> str:
    return "accepted" if isinstance(outcome, LoopClosure) else f"rejected.{outcome.stage}"
