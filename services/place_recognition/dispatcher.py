"""Lends jobs to workers and collects outcomes; knows neither clock nor bus.

pending -> leased -> done, or back to pending when a lease ends without an outcome, or dead after
too many failures. At-least-once execution, exactly-once effect: outcomes are deduplicated by job
id.

Source: decisions 0006 (pull with leases, liveliness as accelerator) and 0028 (what is a failure,
which job is next, which are given up when too many wait).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

from covinz.config import PlaceRecognitionConfig, WorkerConfig
from covinz.types import (
    JobPage,
    JobState,
    Lease,
    LogMark,
    LoopClosure,
    LoopJob,
    Outcome,
    Rejected,
    Rejection,
    RetryAfter,
)
from services.place_recognition.job_state import Asker, Effects, Job, counter_of, given_up
from services.place_recognition.journal import Journal
from services.place_recognition.locality import Locality
from services.place_recognition.loop_graph import LoopGraph
from services.place_recognition.pending import Pending

T = TypeVar("T")

# Job records in one answer; one is about 2 kB.
PAGE_RECORDS = 256
# What a worker is told to wait while the log is not known yet. [s]
RETRY_AFTER_S = 0.5
# Workers that vanished and may come back are remembered up to this number.
MAX_REMEMBERED = 1024
# Of a full queue so much is kept, so that it is not sorted for every job.
KEPT_SHARE = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class _Loan:
    job: Job
    until_s: float


@dataclass(frozen=True, slots=True, eq=False)
class _Waiter(Generic[Asker]):
    asker: Asker
    until_s: float


class Dispatcher(Generic[Asker]):
    """All jobs of one log and who works on them.

    A worker holds at most one lease and one open request: asking again ends both. A lease that
    ends so has not reached it. A failure is a lease that ends at its deadline, or whose worker
    vanished and does not come back. Times are in seconds of one monotonic clock. An `Asker` is
    whatever stands for an open request.
    """

    def __init__(
        self, config: PlaceRecognitionConfig, workers: WorkerConfig, journal: Journal
    ) -> None:
        self._config = config
        self._journal = journal
        self._waiters: dict[str, _Waiter[Asker]] = {}
        self._gone: dict[str, None] = {}
        self._locality = Locality(workers.cache_keyframes)
        self._turned_away: list[Asker] = []
        # Empty until it is known whether the journal's log is still the one.
        self._log_id = ""
        self._forget_jobs()

    def _forget_jobs(self) -> None:
        self._jobs: list[Job] = []
        self._by_id: dict[str, Job] = {}
        self._graph = LoopGraph()
        self._pending = Pending(self._graph)
        self._loans: dict[str, _Loan] = {}
        # What vanished workers had in hand: not their jobs' fault if they come back.
        self._doubts: dict[str, _Loan] = {}
        self._dead: list[tuple[LoopJob, Rejection]] = []
        self._shed: list[Rejection] = []
        self._outcomes: Counter[str] = Counter()
        self._returned = 0

    @property
    def pending(self) -> int:
        """Jobs that wait for a worker."""
        return len(self._pending)

    @property
    def is_full(self) -> bool:
        """As many jobs wait as may."""
        return len(self._pending) >= self._config.max_pending_jobs

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

    def know(self, mark: LogMark) -> None:
        """The log has these entries: jobs that are noted from now on may be of them."""
        self._journal.note_seen(mark)

    def add(self, job: LoopJob) -> None:
        """Take a new job in; its outcome may be known from before."""
        known = self._journal.recall(job.id)
        entry = Job(len(self._jobs), job, known.state, known.failures, known.outcome)
        self._jobs.append(entry)
        self._by_id[job.id] = entry
        if known.outcome is not None:
            self._count(known.outcome)
            if known.state is JobState.DEAD and isinstance(known.outcome, Rejection):
                self._dead.append((job, known.outcome))
        else:
            self._return(entry)

    def shed(self) -> None:
        """Give up the least useful jobs when more wait than may.

        Each gets an outcome of its own that says so, as durable as any other.
        """
        limit = self._config.max_pending_jobs
        waiting = len(self._pending)
        if waiting <= limit:
            return
        for number in self._pending.overflow(int(KEPT_SHARE * limit)):
            entry = self._jobs[number]
            detail = "jobs came faster than the loop solvers work; this was one of the least useful"
            rejection = given_up(entry, "shed", waiting, limit, detail)
            self._settle(entry, rejection, JobState.DONE)
            self._shed.append(rejection)

    def retry(self, job_id: str) -> bool:
        """Let a job that was given up wait for a worker again; False for any other."""
        entry = self._by_id.get(job_id)
        if entry is None or not isinstance(entry.outcome, Rejection):
            return False
        if entry.outcome.stage not in ("dead_letter", "shed"):
            return False
        self._forget_outcome(entry, failures=0)
        self._return(entry)
        return True

    def request(
        self, worker: str, asker: Asker, now_s: float, patience_s: float | None = None
    ) -> None:
        """A worker asks for a job; answered by `advance`, perhaps much later.

        Args:
            worker: Its name.
            asker: Stands for the request.
            now_s: Time.
            patience_s: How long it waits for a job at most; `long_poll_s` unless told.
        """
        if worker in self._gone:
            # It died with this request on its way; one that lives will ask again.
            del self._gone[worker]
            self._turned_away.append(asker)
            return
        self._absolve(worker)
        self._end_worker(worker, failed=False)
        wait_s = self._config.long_poll_s if patience_s is None else patience_s
        self._waiters[worker] = _Waiter(asker, now_s + wait_s)

    def worker_gone(self, worker: str) -> None:
        """The liveliness token of a worker vanished: its lease and its request end."""
        _remember(self._gone, worker, None)
        self._locality.gone(worker)
        loan = self._loans.get(worker)
        self._end_worker(worker, failed=True)
        if loan is not None:
            _remember(self._doubts, worker, loan)

    def worker_back(self, worker: str) -> None:
        """The token is there: the worker lives and has its job still, only the link was lost."""
        self._gone.pop(worker, None)
        loan = self._doubts.get(worker)
        if loan is None:
            return
        entry = loan.job
        self._absolve(worker)
        if entry.state is JobState.PENDING:
            self._pending.discard(entry.number)
            entry.state = JobState.LEASED
            self._loans[worker] = loan

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

    def finish(self, outcome: Outcome, worker: str = "") -> bool:
        """Take an outcome, whatever became of its lease; False when there was one before.

        A dead job comes back to life: its worker was only slow.
        """
        self._absolve(worker)
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
                self._end_loan(worker, failed=True)
        granted = []
        while self._pending and self._waiters:
            worker = next(iter(self._waiters))
            waiter = self._waiters.pop(worker)
            granted.append((waiter.asker, self._lend(worker, now_s)))
        for worker, waiter in list(self._waiters.items()):
            if waiter.until_s <= now_s:
                self._turned_away.append(self._waiters.pop(worker).asker)
        effects = Effects(
            tuple(granted), tuple(self._turned_away), tuple(self._dead), tuple(self._shed)
        )
        self._turned_away, self._dead, self._shed = [], [], []
        return effects

    def next_deadline_s(self) -> float | None:
        """When `advance` has something to do next, if nothing else happens."""
        loans = (loan.until_s for loan in self._loans.values())
        waiters = (waiter.until_s for waiter in self._waiters.values())
        return min((*loans, *waiters), default=None)

    def page(self, first: int) -> JobPage:
        """The jobs from number `first` on, in order of creation; at most `PAGE_RECORDS`."""
        records = tuple(entry.record for entry in self._jobs[first : first + PAGE_RECORDS])
        return JobPage(total=len(self._jobs), first=first, records=records)

    def _lend(self, worker: str, now_s: float) -> Lease:
        suits = partial(self._locality.num_known, worker)
        entry = self._jobs[self._pending.pop(suits)]
        self._locality.lent(worker, entry.job)
        entry.state = JobState.LEASED
        self._loans[worker] = _Loan(entry, now_s + self._config.lease_s)
        attempt = entry.failures + 1
        return Lease(entry.job, worker, attempt, self._config.lease_s, self._log_id)

    def _end_worker(self, worker: str, failed: bool) -> None:
        waiter = self._waiters.pop(worker, None)
        if waiter is not None:
            self._turned_away.append(waiter.asker)
        if worker in self._loans:
            self._end_loan(worker, failed)

    def _end_loan(self, worker: str, failed: bool) -> None:
        entry = self._loans.pop(worker).job
        self._returned += 1
        if failed:
            entry.failures += 1
            self._journal.note_failures(entry.job.id, entry.failures)
        self._return(entry)

    def _absolve(self, worker: str) -> None:
        """A worker that had vanished lives: its job has failed once less, and is not dead."""
        loan = self._doubts.pop(worker, None)
        if loan is None or not loan.job.failures:
            return
        entry = loan.job
        entry.failures -= 1
        if entry.state is JobState.DEAD:
            self._forget_outcome(entry, entry.failures)
            self._return(entry)
        else:
            self._journal.note_failures(entry.job.id, entry.failures)

    def _return(self, entry: Job) -> None:
        """Make a job without an outcome available, or give it up."""
        if entry.failures < self._config.max_attempts:
            entry.state = JobState.PENDING
            self._pending.add(entry.number, entry.job)
            return
        detail = "every worker that took the job failed to return an outcome"
        limit = self._config.max_attempts
        rejection = given_up(entry, "dead_letter", entry.failures, limit, detail)
        self._settle(entry, rejection, JobState.DEAD)
        self._dead.append((entry.job, rejection))

    def _settle(self, entry: Job, outcome: Outcome, state: JobState) -> None:
        self._journal.note_outcome(outcome, state)
        self._pending.discard(entry.number)
        for worker, loan in list(self._loans.items()):
            if loan.job is entry:
                del self._loans[worker]
        if entry.outcome is not None:
            self._outcomes[counter_of(entry.outcome)] -= 1
        self._count(outcome)
        entry.state, entry.outcome = state, outcome

    def _count(self, outcome: Outcome) -> None:
        self._outcomes[counter_of(outcome)] += 1
        if isinstance(outcome, LoopClosure):
            self._graph.join(outcome.query, outcome.cand)

    def _forget_outcome(self, entry: Job, failures: int) -> None:
        if entry.outcome is not None:
            self._outcomes[counter_of(entry.outcome)] -= 1
        entry.outcome, entry.failures = None, failures
        self._journal.forget(entry.job.id)
        self._journal.note_failures(entry.job.id, failures)


def _remember(known: dict[str, T], name: str, what: T) -> None:
    """Keep the newest names only."""
    known.pop(name, None)
    known[name] = what
    if len(known) > MAX_REMEMBERED:
        del known[next(iter(known))]
