"""The dispatcher on the bus: requests come in as events, answers leave once they are durable."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass

from covinz import codec, keyexprs
from covinz.bus import Bus, Query
from covinz.codec import MalformedMessage
from covinz.damage import CommitFailed, Trouble
from covinz.logs import about
from covinz.service import Inbox
from covinz.types import (
    Duplicate,
    JobDone,
    JobRange,
    LeaseRequest,
    LoopJob,
    LoopPage,
    LoopRange,
    Rejected,
    Rejection,
    Stored,
    UploadReply,
)
from services.place_recognition.dispatcher import Dispatcher
from services.place_recognition.job_state import Effects
from services.place_recognition.journal import Journal

logger = logging.getLogger(__name__)

# While the journal cannot be written, e.g. since the disk is full, it is tried so often. [s]
RETRY_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class LeaseAsked:
    """A worker wants a job."""

    query: Query


@dataclass(frozen=True, slots=True, eq=False)
class OutcomeBrought:
    """A worker returns an outcome."""

    query: Query


@dataclass(frozen=True, slots=True, eq=False)
class JobsAsked:
    """Somebody wants to see the jobs."""

    query: Query


@dataclass(frozen=True, slots=True)
class WorkerGone:
    """The liveliness token of a worker vanished."""

    worker: str


@dataclass(frozen=True, slots=True)
class WorkerBack:
    """The liveliness token of a worker is there."""

    worker: str


@dataclass(frozen=True, slots=True, eq=False)
class RetryAsked:
    """Somebody wants a job that was given up to be done after all."""

    query: Query


@dataclass(frozen=True, slots=True, eq=False)
class LoopsAsked:
    """The optimizer wants to see whether it has all accepted loops."""

    query: Query


Question = LeaseAsked | OutcomeBrought | JobsAsked | LoopsAsked | RetryAsked
DeskEvent = Question | WorkerGone | WorkerBack


class Desk:
    """Where workers take jobs and bring outcomes.

    `handle` only changes the dispatcher; `settle` commits the journal and then answers, so that an
    acknowledgement that a worker has seen is never forgotten. While the journal cannot be written
    nothing is lent or acknowledged: workers ask again.

    Args:
        dispatcher: Has the jobs.
        journal: Its durable memory.
        bus: To tell viewers what was given up.
        save: Keeps the input of a job whose workers all failed.
    """

    def __init__(
        self,
        dispatcher: Dispatcher[Query],
        journal: Journal,
        bus: Bus,
        save: Callable[[LoopJob], object] = lambda _: None,
    ) -> None:
        self._dispatcher = dispatcher
        self._journal = journal
        self._bus = bus
        self._save = save
        self._acks: list[tuple[Query, UploadReply]] = []
        # Workers that want their next job as the answer to an outcome.
        self._next: list[tuple[str, Query]] = []
        # Given up, and nobody was told yet.
        self._dead: list[tuple[LoopJob, Rejection]] = []
        self._shed: list[Rejection] = []
        self._trouble: Trouble | None = None
        self._retry_at_s = 0.0  # while there is trouble
        self._counters: Counter[str] = Counter()

    @property
    def counters(self) -> Counter[str]:
        """What came and was odd; ``cannot_store.<trouble>`` is 1 while the journal cannot be."""
        trouble = {f"cannot_store.{self._trouble.value}": 1} if self._trouble else {}
        return self._counters + Counter(trouble)

    def next_deadline_s(self) -> float | None:
        """When `settle` has something to do next, if nothing else happens."""
        return self._retry_at_s if self._trouble else self._dispatcher.next_deadline_s()

    def handle(self, event: DeskEvent, now_s: float) -> None:
        """Take one event in."""
        try:
            match event:
                case LeaseAsked(query):
                    worker = codec.decode(query.payload, LeaseRequest).worker
                    self._dispatcher.request(worker, query, now_s)
                case OutcomeBrought(query):
                    self._bring(query)
                case JobsAsked(query):
                    first = codec.decode(query.payload, JobRange).first
                    query.reply(codec.encode(self._dispatcher.page(first)))
                case LoopsAsked(query):
                    after = codec.decode(query.payload, LoopRange).after
                    page = LoopPage(self._journal.log_id, tuple(self._journal.loops(after)))
                    query.reply(codec.encode(page))
                case RetryAsked(query):
                    self._retry(query)
                case WorkerGone(worker):
                    self._dispatcher.worker_gone(worker)
                case WorkerBack(worker):
                    self._dispatcher.worker_back(worker)
        except MalformedMessage as error:
            self._refuse(event, error)

    def settle(self, now_s: float) -> None:
        """Make what was handled durable, then tell those who wait."""
        if self._trouble and now_s < self._retry_at_s:
            return self._refuse_acks()
        for worker, query in self._next:
            self._dispatcher.request(worker, query, now_s, patience_s=0.0)
        effects = self._dispatcher.advance(now_s)
        self._dead += effects.dead
        self._shed += effects.shed
        if not self._commit(now_s):
            for query in (*(query for query, _ in effects.granted), *effects.turned_away):
                query.drop()
            return self._refuse_acks()
        self._answer(effects)
        self._tell_given_up()
        return None

    def _answer(self, effects: Effects[Query]) -> None:
        """A lease is also an acknowledgement, and a query that got one is not turned away."""
        for query, lease in effects.granted:
            query.reply(codec.encode(lease))
        leased = {id(query) for query, _ in effects.granted}
        for query, ack in self._acks:
            if id(query) not in leased:
                query.reply(codec.encode(ack))
        self._acks.clear()
        self._next.clear()
        for query in effects.turned_away:
            query.drop()

    def _tell_given_up(self) -> None:
        for job, rejection in self._dead:
            logger.error(
                "job %s is dead: %s",
                rejection.job_id,
                rejection.detail,
                extra=about(keyframe=rejection.query, job=rejection.job_id),
            )
            self._bus.put(keyexprs.REJECTION, codec.encode(rejection))
            self._save(job)
        if self._shed:
            logger.error("%d jobs given up: too many wait", len(self._shed))
        for rejection in self._shed:
            self._bus.put(keyexprs.REJECTION, codec.encode(rejection))
        self._dead.clear()
        self._shed.clear()

    def _commit(self, now_s: float) -> bool:
        try:
            self._journal.commit()
        except CommitFailed as error:
            if self._trouble is not error.trouble:
                logger.error("no job is lent and no outcome acknowledged: %s", error)
            self._trouble, self._retry_at_s = error.trouble, now_s + RETRY_S
            return False
        if self._trouble:
            logger.warning("the journal can be written again")
            self._trouble = None
        return True

    def _refuse_acks(self) -> None:
        """Their senders ask again; what they brought is noted."""
        for query, _ in self._acks:
            query.drop()
        self._acks.clear()
        self._next.clear()

    def _bring(self, query: Query) -> None:
        done = codec.decode(query.payload, JobDone)
        if (objection := self._dispatcher.objection(done.log_id)) is not None:
            self._counters["outcomes_of_other_logs"] += 1
            self._acks.append((query, objection))
            return
        fresh = self._dispatcher.finish(done.outcome, done.worker)
        self._counters["duplicate_outcomes"] += not fresh
        self._acks.append((query, Stored() if fresh else Duplicate()))
        if done.wants_next:
            self._next.append((done.worker, query))

    def _retry(self, query: Query) -> None:
        try:
            job_id = keyexprs.job_of(query.key)
        except ValueError as error:
            raise MalformedMessage(str(error)) from error
        if self._dispatcher.retry(job_id):
            self._acks.append((query, Stored()))
        else:
            self._acks.append((query, Rejected("not_given_up", f"job {job_id} is no dead letter")))

    def _refuse(self, event: DeskEvent, error: MalformedMessage) -> None:
        self._counters["malformed"] += 1
        logger.warning("refused %s: %s", type(event).__name__, error)
        if isinstance(event, OutcomeBrought):
            event.query.reply(codec.encode(Rejected("malformed", str(error))))
        elif not isinstance(event, WorkerGone | WorkerBack):
            event.query.drop()


def open_desk(bus: Bus, inbox: Inbox) -> ExitStack:
    """Take requests of workers and viewers into the inbox until the stack is closed.

    When the inbox is full a request is dropped at once: its sender tries again.
    """

    def enqueue(event: Question) -> None:
        if not inbox.put(event, block=False):
            event.query.drop()

    def on_worker(key: str, alive: bool) -> None:
        worker = keyexprs.worker_of(key)
        inbox.put_always(WorkerBack(worker) if alive else WorkerGone(worker))

    stack = ExitStack()
    for declaration in (
        bus.answer(keyexprs.JOB_LEASE, lambda query: enqueue(LeaseAsked(query))),
        bus.answer(keyexprs.JOB_DONE, lambda query: enqueue(OutcomeBrought(query))),
        bus.answer(keyexprs.JOB_LIST, lambda query: enqueue(JobsAsked(query))),
        bus.answer(keyexprs.JOB_LOOPS, lambda query: enqueue(LoopsAsked(query))),
        bus.answer(keyexprs.JOB_RETRIES, lambda query: enqueue(RetryAsked(query))),
        bus.watch_alive(keyexprs.WORKERS_ALIVE, on_worker),
    ):
        stack.enter_context(closing(declaration))
    return stack
