from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from covinz import codec, keyexprs
from covinz.bus import BusClosed, Query
from covinz.codec import MalformedMessage
from covinz.config import WorkerConfig
from covinz.keyframes import StoreUnavailable
from covinz.memory_bus import Hub, InMemoryBus
from covinz.types import (
    Duplicate,
    JobDone,
    Lease,
    LeaseRequest,
    LogPage,
    LoopClosure,
    LoopJob,
    Outcome,
    Rejected,
    Rejection,
    RetryAfter,
    Stored,
    UploadReply,
)
from services.loop_solver.worker import Worker

PATIENCE_S = 20.0
LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
OTHER_LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAW"


class Server:
    """Dispatcher, optimizer and ingest as a worker sees them: every question waits for the test."""

    def __init__(self, bus: InMemoryBus) -> None:
        self.leases: queue.Queue[Query] = queue.Queue()
        self.loops: queue.Queue[Query] = queue.Queue()
        self.done: queue.Queue[Query] = queue.Queue()
        self.rejections: queue.Queue[bytes] = queue.Queue()
        self.ranges: queue.Queue[Query] = queue.Queue()
        bus.answer(keyexprs.LOG_RANGE, self.ranges.put)
        bus.answer(keyexprs.JOB_LEASE, self.leases.put)
        self._bus = bus
        self._optimizer = bus.answer(keyexprs.LOOP, self.loops.put)
        bus.answer(keyexprs.JOB_DONE, self.done.put)
        bus.subscribe(keyexprs.REJECTION, lambda _, payload: self.rejections.put(payload))

    def lend(self, job: LoopJob, log_id: str = "") -> str:
        """Answer the next request with a job; returns the worker's name."""
        query = self.leases.get(timeout=PATIENCE_S)
        worker = codec.decode(query.payload, LeaseRequest).worker
        query.reply(codec.encode(Lease(job, worker, 1, 60.0, log_id)))
        return worker

    def take_loop(self, answer: UploadReply) -> LoopClosure:
        """Answer the next loop."""
        query = self.loops.get(timeout=PATIENCE_S)
        query.reply(codec.encode(answer))
        return codec.decode(query.payload, LoopClosure)

    def take_done(self, answer: UploadReply | Lease | None = None) -> JobDone:
        """Acknowledge the next outcome, perhaps with the next job."""
        query = self.done.get(timeout=PATIENCE_S)
        query.reply(codec.encode(answer or Stored()))
        return codec.decode(query.payload, JobDone)


def loop_of(job: LoopJob) -> LoopClosure:
    return LoopClosure(job.id, job.query, job.cand, np.eye(4), np.eye(6), 120, 400, 3.0)


def rejection_of(job: LoopJob) -> Rejection:
    return Rejection(job.id, job.query, job.cand, "matches", 4.0, 30.0, "", 3.0)


@pytest.fixture
def hub() -> Hub:
    return Hub()


@pytest.fixture
def server(hub: Hub) -> Iterator[Server]:
    with closing(hub.join()) as bus:
        yield Server(bus)


Start = Callable[[Callable[[LoopJob], Outcome]], Worker]


@pytest.fixture
def failures() -> list[BaseException]:
    return []


@pytest.fixture
def start(hub: Hub, failures: list[BaseException]) -> Iterator[Start]:
    """Starts a worker; stops it at the end of the test, with its bus cut off."""
    with closing(hub.join()) as bus:
        workers = []

        def start(solve: Callable[[LoopJob], Outcome]) -> Worker:
            config = WorkerConfig(min_backoff_s=0.001, max_backoff_s=0.01)
            worker = Worker("w-1", bus, solve, config, PATIENCE_S, failures.append)
            worker.start()
            workers.append(worker)
            return worker

        yield start
        bus.interrupt()
        for worker in workers:
            worker.stop()


def test_a_loop_goes_to_the_optimizer_before_the_job_is_done(
    room: Any, server: Server, start: Start
) -> None:
    worker = start(loop_of)
    assert server.lend(room.job) == "w-1"
    assert server.take_loop(Stored()).job_id == room.job.id
    assert server.done.empty()
    done = server.take_done()
    assert (done.worker, done.outcome.job_id) == ("w-1", room.job.id)
    # Once more, for an optimizer that lost its file and read the journal before the outcome came.
    assert server.take_loop(Duplicate()).job_id == room.job.id
    server.leases.get(timeout=PATIENCE_S)
    assert worker.counters["accepted"] == 1 and not worker.busy


def test_a_rejection_is_published_and_brought_back(room: Any, server: Server, start: Start) -> None:
    worker = start(rejection_of)
    server.lend(room.job)
    assert server.take_done().outcome == rejection_of(room.job)
    published = codec.decode(server.rejections.get(timeout=PATIENCE_S), Rejection)
    assert published == rejection_of(room.job)
    assert server.loops.empty()
    server.leases.get(timeout=PATIENCE_S)
    assert worker.counters["rejected.matches"] == 1


def test_a_loop_is_sent_until_it_is_acknowledged(room: Any, server: Server, start: Start) -> None:
    start(loop_of)
    server.lend(room.job)
    # The optimizer dies with the question, then is not ready, then has it already.
    server.loops.get(timeout=PATIENCE_S).drop()
    server.take_loop(RetryAfter(0.001, "starting"))
    server.loops.get(timeout=PATIENCE_S).reply(b"garbage")
    assert server.done.empty()
    server.take_loop(Duplicate())
    assert isinstance(server.take_done().outcome, LoopClosure)


def test_an_outcome_is_sent_until_it_is_acknowledged(
    room: Any, server: Server, start: Start
) -> None:
    start(rejection_of)
    server.lend(room.job)
    server.done.get(timeout=PATIENCE_S).drop()
    server.done.get(timeout=PATIENCE_S).drop()
    assert server.leases.empty()
    server.take_done(Duplicate())
    server.leases.get(timeout=PATIENCE_S)


def test_the_next_job_may_come_as_the_answer_to_an_outcome(
    room: Any, server: Server, start: Start
) -> None:
    worker = start(loop_of)
    server.lend(room.job)
    for _ in range(3):
        server.take_loop(Stored())
        assert server.take_done(Lease(room.job, "w-1", 1, 60.0)).wants_next
        server.take_loop(Duplicate())
    assert server.leases.empty() and worker.busy
    server.take_loop(Stored())
    assert server.take_done(Stored()).wants_next
    server.take_loop(Duplicate())
    server.leases.get(timeout=PATIENCE_S)
    assert worker.counters["accepted"] == 4 and not worker.busy


def test_a_next_job_that_cannot_be_read_ends_the_worker(
    room: Any, server: Server, start: Start, failures: list[Any]
) -> None:
    worker = start(rejection_of)
    server.lend(room.job)
    query = server.done.get(timeout=PATIENCE_S)
    query.reply(codec.encode(Lease(room.job, "w-1", 1, 60.0))[:-40])
    worker.join()
    assert [type(failure) for failure in failures] == [MalformedMessage]


def test_a_loop_that_the_optimizer_refuses_is_a_rejection(
    room: Any, server: Server, start: Start
) -> None:
    start(loop_of)
    server.lend(room.job)
    server.take_loop(Rejected("not_rigid", "T_cand_query is not rigid"))
    outcome = server.take_done().outcome
    assert isinstance(outcome, Rejection)
    assert outcome.stage == "refused" and "not_rigid" in outcome.detail


def test_a_loop_of_a_lost_log_is_not_sent_for_ever(room: Any, server: Server, start: Start) -> None:
    start(loop_of)
    server.lend(room.job, LOG)
    # The optimizer is only late, then ingest has begun another log.
    for log_id in (LOG, OTHER_LOG):
        assert server.take_loop(RetryAfter(0.001, "another log")).log_id == LOG
        query = server.ranges.get(timeout=PATIENCE_S)
        query.reply(codec.encode(LogPage(log_id, 7, ())))
    done = server.take_done(Rejected("other_log", "lost"))
    assert done.log_id == LOG
    assert isinstance(done.outcome, Rejection) and "other_log" in done.outcome.detail
    server.leases.get(timeout=PATIENCE_S)


def test_a_job_waits_for_the_keyframes(room: Any, server: Server, start: Start) -> None:
    away = iter([True, True, False])

    def solve(job: LoopJob) -> Outcome:
        if next(away):
            raise StoreUnavailable("ingest does not answer")
        return rejection_of(job)

    start(solve)
    server.lend(room.job)
    assert isinstance(server.take_done().outcome, Rejection)


def test_a_request_without_a_job_is_repeated(room: Any, server: Server, start: Start) -> None:
    start(rejection_of)
    for _ in range(3):
        server.leases.get(timeout=PATIENCE_S).drop()
    server.lend(room.job)
    server.take_done()


def test_it_comes_when_the_dispatcher_does(room: Any, hub: Hub, start: Start) -> None:
    start(rejection_of)
    with closing(hub.join()) as bus:
        server = Server(bus)
        server.lend(room.job)
        server.take_done()


def test_stopping_ends_an_open_request(server: Server, start: Start) -> None:
    worker = start(rejection_of)
    server.leases.get(timeout=PATIENCE_S)
    worker.stop()
    assert not worker.busy


def test_stopping_finishes_the_job_at_hand(room: Any, server: Server, start: Start) -> None:
    begun, finish = threading.Event(), threading.Event()

    def solve(job: LoopJob) -> Outcome:
        begun.set()
        finish.wait(PATIENCE_S)
        return loop_of(job)

    worker = start(solve)
    server.lend(room.job)
    assert begun.wait(PATIENCE_S) and worker.busy
    stopping = threading.Thread(target=worker.stop)
    stopping.start()
    finish.set()
    server.take_loop(Stored())
    assert not server.take_done().wants_next
    server.take_loop(Duplicate())
    stopping.join(PATIENCE_S)
    assert not stopping.is_alive()
    assert server.leases.empty()


def test_a_job_that_comes_while_stopping_is_worked_off(
    room: Any, server: Server, start: Start
) -> None:
    worker = start(rejection_of)
    server.lend(room.job)
    query = server.done.get(timeout=PATIENCE_S)
    stopping = threading.Thread(target=worker.stop)
    stopping.start()
    query.reply(codec.encode(Lease(room.job, "w-1", 1, 60.0)))
    while codec.decode((query := server.done.get(timeout=PATIENCE_S)).payload, JobDone).wants_next:
        # The thread that stops it had not come so far yet.
        query.reply(codec.encode(Lease(room.job, "w-1", 1, 60.0)))
    query.reply(codec.encode(Stored()))
    stopping.join(PATIENCE_S)
    assert not stopping.is_alive()
    assert server.leases.empty()


def test_stopping_does_not_wait_for_those_who_are_away(
    room: Any, server: Server, start: Start
) -> None:
    solved = threading.Event()

    def solve(job: LoopJob) -> Outcome:
        solved.set()
        return loop_of(job)

    worker = start(solve)
    server.lend(room.job)
    assert solved.wait(PATIENCE_S)
    server.loops.get(timeout=PATIENCE_S).drop()
    stopping = threading.Thread(target=worker.stop)
    stopping.start()
    # One last attempt may come, answered by nobody.
    while stopping.is_alive():
        try:
            server.loops.get(timeout=0.01).drop()
        except queue.Empty:
            stopping.join(0.01)
    assert server.done.empty()


def test_the_token_lives_as_long_as_the_worker(hub: Hub, server: Server, start: Start) -> None:
    watched: queue.Queue[tuple[str, bool]] = queue.Queue()
    with closing(hub.join()) as bus:
        bus.watch_alive(keyexprs.WORKERS_ALIVE, lambda key, alive: watched.put((key, alive)))
        worker = start(rejection_of)
        key, alive = watched.get(timeout=PATIENCE_S)
        assert (keyexprs.worker_of(key), alive) == ("w-1", True)
        server.leases.get(timeout=PATIENCE_S)
        worker.stop()
        assert watched.get(timeout=PATIENCE_S) == (key, False)


def test_a_bug_is_reported(room: Any, server: Server, start: Start, failures: list[Any]) -> None:
    def solve(job: LoopJob) -> Outcome:
        raise ZeroDivisionError("a bug")

    worker = start(solve)
    server.lend(room.job)
    worker.join()
    assert [type(failure) for failure in failures] == [ZeroDivisionError]


def test_a_lease_that_cannot_be_read_ends_the_worker(
    hub: Hub, start: Start, failures: list[Any]
) -> None:
    dispatcher = hub.join()
    dispatcher.answer(keyexprs.JOB_LEASE, lambda query: query.reply(b"of another version"))
    start(rejection_of).join()
    dispatcher.close()
    assert [type(failure) for failure in failures] == [MalformedMessage]


def test_a_bus_that_is_cut_off_unasked_is_a_failure(
    hub: Hub, server: Server, failures: list[Any]
) -> None:
    bus = hub.join()
    worker = Worker("w-2", bus, rejection_of, WorkerConfig(), PATIENCE_S, failures.append)
    worker.start()
    server.leases.get(timeout=PATIENCE_S)
    bus.close()
    worker.join()
    assert [type(failure) for failure in failures] == [BusClosed]
