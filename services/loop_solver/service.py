"""A loop solver as a process: one thread works, the owner of the inbox answers for it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Protocol

from covinz.config import LoopSolverConfig
from covinz.keyframes import KeyframeStore, RemoteKeyframeStore
from covinz.service import Context, StatusRequest
from covinz.types import LoopJob, Outcome, Status
from covinz.ulid import new_ulid
from services.loop_solver.solver import LoopSolver
from services.loop_solver.worker import Worker


@dataclass(frozen=True, slots=True, eq=False)
class WorkerFailed:
    """The working thread ended with an error, so the process must too."""

    error: BaseException


class Solver(Protocol):
    """Verifies candidates; `LoopSolver`."""

    def solve(self, job: LoopJob) -> Outcome:
        """The outcome of a job; StoreUnavailable when its keyframes cannot be had now."""


NewSolver = Callable[[LoopSolverConfig, KeyframeStore], Solver]


def run(context: Context, new_solver: NewSolver = LoopSolver) -> None:
    """Work until `context.inbox` raises Stopped; the job at hand is finished first.

    Args:
        context: What the process is given.
        new_solver: Makes the solver.
    """
    config = context.config
    store = RemoteKeyframeStore(context.bus, config.worker.cache_keyframes)
    solver = new_solver(config.loop_solver, store)
    # Later its lease has ended, and the job is somebody else's.
    solving = context.watch.work("solving a job", config.place_recognition.lease_s)

    def solve(job: LoopJob) -> Outcome:
        with solving:
            outcome = solver.solve(job)
        context.telemetry.observe("loop_solver_solve", outcome.solver_ms / 1e3)
        return outcome

    worker = Worker(
        # A process that is started again must not be taken for the one that died.
        worker=f"{context.instance}-{new_ulid(context.machine)}",
        bus=context.bus,
        solve=solve,
        config=config.worker,
        lease_timeout_s=config.place_recognition.long_poll_s + config.bus.query_timeout_s,
        on_failure=lambda error: context.inbox.put_always(WorkerFailed(error)),
        machine=context.machine,
    )
    with ExitStack() as stack:
        stack.callback(worker.stop)
        worker.start()
        while True:
            event = context.inbox.take(None)
            if isinstance(event, StatusRequest):
                event.answer(status(context.instance, worker))
            elif isinstance(event, WorkerFailed):
                raise event.error


def status(instance: str, worker: Worker) -> Status:
    """A worker follows no log; `leased` says whether it works on a job."""
    return Status(
        service="loop_solver",
        instance=instance,
        log_id="",
        cursor=0,
        pending=0,
        leased=int(worker.busy),
        dirty=False,
        counters={name: float(count) for name, count in sorted(worker.counters.items())},
    )
