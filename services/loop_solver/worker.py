"""The pull loop of a worker: take a job, solve it, bring the outcome until it is durable.

A loop goes to the optimizer first and to the dispatcher then, each until acknowledged: a job that
counts as done has its loop in the map's books. Both deduplicate, so a crash in between only costs
a second solve. The answer to an outcome may be the next job.

Source: docs/architecture.md; decisions 0006 (pull with leases) and 0035 (the next job).
"""

from __future__ import annotations

import dataclasses
import logging
from collections import Counter
from collections.abc import Callable, Iterator

from covinz import codec, keyexprs
from covinz.bus import Bus, BusClosed
from covinz.codec import MalformedMessage
from covinz.config import WorkerConfig
from covinz.keyframes import StoreUnavailable
from covinz.logs import about
from covinz.machine import THIS_MACHINE, Machine
from covinz.types import (
    JobDone,
    Lease,
    LeaseRequest,
    LogPage,
    LogRange,
    LogView,
    LoopClosure,
    LoopJob,
    Outcome,
    Rejected,
    Rejection,
    RetryAfter,
    UploadReply,
)

logger = logging.getLogger(__name__)

# A lease request that ends sooner without a job found nobody, or was refused.
PROMPT_S = 0.5
# No log has such an entry: the answer is its name alone.
PAST_ANY_HEAD = 2**63 - 1


class Worker:
    """One thread that works off jobs one at a time until `stop`.

    Args:
        worker: Id of this run; no other process, earlier or later, may have the same.
        bus: Way to dispatcher and optimizer.
        solve: Turns a job into its outcome; StoreUnavailable means try again.
        config: Back-off.
        lease_timeout_s: How long a request for a job may stay open.
        on_failure: Called from the thread with the error that ended it.
        machine: Clock and thread.
    """

    def __init__(
        self,
        worker: str,
        bus: Bus,
        solve: Callable[[LoopJob], Outcome],
        config: WorkerConfig,
        lease_timeout_s: float,
        on_failure: Callable[[BaseException], object],
        machine: Machine = THIS_MACHINE,
    ) -> None:
        self._worker = worker
        self._bus = bus
        self._solve = solve
        self._config = config
        self._lease_timeout_s = lease_timeout_s
        self._on_failure = on_failure
        self._clock_s = machine.monotonic_s
        self._stopping = False
        # Ends a pause early: the process stops, or somebody who was away is back.
        self._news = machine.event()
        # Guards `_asking`, so that stop() and a lease that arrives agree on who was first.
        self._lock = machine.lock()
        self._asking = False
        self._busy = False
        self._declared = [bus.declare_alive(keyexprs.worker_alive(worker))]
        for key in (keyexprs.JOB_LEASE, keyexprs.JOB_DONE, keyexprs.LOOP):
            self._declared.append(bus.watch_answered(key, self._on_answered))
        self._thread = machine.thread(self._run, "worker", computes=True)
        self.counters: Counter[str] = Counter()

    @property
    def busy(self) -> bool:
        """Whether a job is being worked on."""
        return self._busy

    def start(self) -> None:
        """Begin to pull jobs."""
        self._thread.start()

    def stop(self) -> None:
        """Take no further job, finish the one at hand, and wait for that."""
        with self._lock:
            self._stopping = True
            self._news.set()
            if self._asking:
                # A lease that is on its way is lost, and ends when the token vanishes.
                self._bus.interrupt()
        self.join()
        for declared in self._declared:
            declared.close()

    def join(self) -> None:
        """Wait for the end of the thread."""
        self._thread.join()

    def _run(self) -> None:
        try:
            self._pull()
        except BusClosed as error:
            if not self._stopping:
                self._on_failure(error)
        except BaseException as error:
            self._on_failure(error)

    def _pull(self) -> None:
        pauses = self._pauses_s()
        while not self._stopping:
            asked_s = self._clock_s()
            lease = self._lease()
            if lease is None and self._clock_s() - asked_s < PROMPT_S:
                self._pause(next(pauses))
                continue
            pauses = self._pauses_s()
            self._busy = lease is not None
            while lease is not None:
                lease = self._work(lease)
            self._busy = False

    def _lease(self) -> Lease | None:
        with self._lock:
            if self._stopping:
                return None
            self._asking = True
        request = codec.encode(LeaseRequest(self._worker))
        replies = self._bus.ask(keyexprs.JOB_LEASE, request, self._lease_timeout_s)
        with self._lock:
            self._asking = False
            if self._stopping:
                return None
        # A lease that cannot be read ends the process, and so counts against its job: asking again
        # would not.
        return codec.decode(replies[0], Lease) if replies else None

    def _work(self, lease: Lease) -> Lease | None:
        """Bring the outcome of a job; returns the next one if there is one at once."""
        job = lease.job
        outcome = self._outcome(job)
        if isinstance(outcome, LoopClosure):
            outcome = self._bring_loop(outcome, lease.log_id)
        if outcome is None:
            logger.info("gave job %s back: the process ends", job.id, extra=about(job=job.id))
            return None
        done = JobDone(self._worker, outcome, lease.log_id, wants_next=not self._stopping)
        payload = codec.encode(done)
        if isinstance(outcome, Rejection):
            self._bus.put(keyexprs.REJECTION, codec.encode(outcome))
        answer = self._send(keyexprs.JOB_DONE, payload)
        if isinstance(outcome, LoopClosure):
            # The optimizer may have lost its file since, and read the journal before the outcome
            # came. That it was away need not have been seen from here, so it is always asked.
            self._bring_loop(outcome, lease.log_id)
        self._count(outcome)
        # One that came although the process ends meanwhile is worked off: nobody else has it.
        return answer if isinstance(answer, Lease) else None

    def _outcome(self, job: LoopJob) -> Outcome | None:
        """The outcome; None when the process ends before the keyframes can be had."""
        for pause_s in self._pauses_s():
            try:
                return self._solve(job)
            except StoreUnavailable as error:
                extra = about(keyframe=job.query, job=job.id)
                logger.warning("job %s waits for its keyframes: %s", job.id, error, extra=extra)
            if self._stopping:
                break
            self._pause(pause_s)
        return None

    def _bring_loop(self, loop: LoopClosure, log_id: str) -> Outcome | None:
        """The outcome once the optimizer has the loop, or will not; None when the process ends."""
        payload = codec.encode(dataclasses.replace(loop, log_id=log_id))
        answer = self._send(keyexprs.LOOP, payload, lambda: self._is_lost(log_id))
        if isinstance(answer, Rejected):
            return _refused(loop, answer)
        return None if answer is None else loop

    def _is_lost(self, log_id: str) -> bool:
        """Whether ingest has another log by now than a job's."""
        question = codec.encode(LogRange(PAST_ANY_HEAD, LogView.POSE))
        for reply in self._bus.ask(keyexprs.LOG_RANGE, question):
            try:
                return codec.decode(reply, LogPage).log_id != log_id
            except MalformedMessage as error:
                logger.error("unreadable answer on %s: %s", keyexprs.LOG_RANGE, error)
        return False

    def _send(
        self, key: str, payload: bytes, is_void: Callable[[], bool] = lambda: False
    ) -> UploadReply | Lease | None:
        """Ask until there is a final answer; None when the process ends before.

        `is_void` is asked whenever the receiver is not ready: it need not wait for ever.
        """
        for pause_s in self._pauses_s():
            wait_s = pause_s
            for reply in self._bus.ask(key, payload):
                if codec.says_it_is(reply, Lease):
                    return codec.decode(reply, Lease)  # or end, as `_lease` does
                try:
                    answer = codec.decode_upload_reply(reply)
                except MalformedMessage as error:
                    logger.error("unreadable answer on %s: %s", key, error)
                    continue
                if not isinstance(answer, RetryAfter):
                    return answer
                wait_s = answer.seconds
                if is_void():
                    return Rejected("other_log", "the job's log was lost")
            self.counters["resent"] += 1
            if self._stopping:
                break
            self._pause(wait_s)
        return None

    def _on_answered(self, is_there: bool) -> None:
        if is_there:
            self._news.set()

    def _pause(self, seconds: float) -> None:
        self._news.wait(seconds)
        if not self._stopping:
            self._news.clear()

    def _pauses_s(self) -> Iterator[float]:
        """Growing pauses between attempts, without end."""
        pause_s = self._config.min_backoff_s
        while True:
            yield pause_s
            pause_s = min(2 * pause_s, self._config.max_backoff_s)

    def _count(self, outcome: Outcome) -> None:
        self.counters["jobs"] += 1
        if isinstance(outcome, LoopClosure):
            self.counters["accepted"] += 1
            logger.info(
                "loop %s -> %s: %d inliers of %d matches, %.0f ms",
                outcome.query,
                outcome.cand,
                outcome.num_inliers,
                outcome.num_matches,
                outcome.solver_ms,
                extra=about(keyframe=outcome.query, job=outcome.job_id),
            )
        else:
            self.counters[f"rejected.{outcome.stage}"] += 1


def _refused(loop: LoopClosure, answer: Rejected) -> Rejection:
    return Rejection(
        job_id=loop.job_id,
        query=loop.query,
        cand=loop.cand,
        stage="refused",
        count=0.0,
        threshold=0.0,
        detail=f"the optimizer refused the loop: {answer.code}: {answer.reason}",
        solver_ms=loop.solver_ms,
    )
