"""The one thread that optimises, on immutable snapshots, while the owner thread goes on."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from covinz.config import OptimizerConfig
from services.optimizer.components import Component
from services.optimizer.optimisation import Fault, MapEstimate, Optimise, find_fault, optimise


@dataclass(frozen=True, slots=True, eq=False)
class Optimised:
    """What came of a job: an estimate, or a loop to blame, for each component.

    Attributes:
        epoch: Given with the job; tells jobs of a forgotten log from others.
        estimates: Of the components that could be optimised.
        faults: One for each component that could not.
        duration_ms: Wall time of the whole job.
    """

    epoch: int
    estimates: tuple[MapEstimate, ...]
    faults: tuple[Fault, ...]
    duration_ms: float


@dataclass(frozen=True, slots=True, eq=False)
class OptimisationCrashed:
    """A job ended in an error that no input explains: a defect, passed to the owner thread."""

    error: BaseException


def run_job(
    components: tuple[Component, ...],
    epoch: int,
    config: OptimizerConfig,
    run: Optimise = optimise,
) -> Optimised:
    """Optimise each of `components`; one that fails does not keep the others from it."""
    started = time.perf_counter()
    estimates, faults = [], []
    for component in components:
        try:
            estimates.append(run(component, config))
        except ValueError as error:
            faults.append(find_fault(component, config, str(error), run))
    duration_ms = 1e3 * (time.perf_counter() - started)
    return Optimised(epoch, tuple(estimates), tuple(faults), duration_ms)


class OptimisationThread:
    """Runs jobs one after the other and reports each to `deliver`, from its own thread."""

    def __init__(self, config: OptimizerConfig, deliver: Callable[[object], object]) -> None:
        self._config = config
        self._deliver = deliver
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="optimise")

    def submit(self, components: tuple[Component, ...], epoch: int) -> None:
        """Queue a job; `deliver` gets its Optimised or OptimisationCrashed."""
        future = self._pool.submit(run_job, components, epoch, self._config)
        future.add_done_callback(self._report)

    def close(self) -> None:
        """Wait for the job that runs."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _report(self, future: Future[Optimised]) -> None:
        if future.cancelled():
            return
        error = future.exception()
        self._deliver(future.result() if error is None else OptimisationCrashed(error))
