"""The one thread that optimises, on immutable snapshots, while the owner thread goes on."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from covinz.config import OptimizerConfig
from covinz.machine import THIS_MACHINE, Machine
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
    """Runs jobs one after the other and reports each to `deliver`, from its own thread.

    Args:
        config: Section `optimizer`.
        deliver: Gets the Optimised or OptimisationCrashed of every job.
        machine: For the thread.
        run: Optimises one map.
    """

    def __init__(
        self,
        config: OptimizerConfig,
        deliver: Callable[[object], object],
        machine: Machine = THIS_MACHINE,
        run: Optimise = optimise,
    ) -> None:
        self._config = config
        self._run_one = run
        self._deliver = deliver
        self._changed = machine.condition()  # guards what follows
        self._jobs: deque[tuple[tuple[Component, ...], int]] = deque()
        self._closing = False
        self._thread = machine.thread(self._run, "optimise", computes=True)
        self._thread.start()

    def submit(self, components: tuple[Component, ...], epoch: int) -> None:
        """Queue a job."""
        with self._changed:
            self._jobs.append((components, epoch))
            self._changed.notify_all()

    def close(self) -> None:
        """Wait for the job that runs; those that wait are forgotten."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closing or self._jobs)
                if self._closing:
                    return
                components, epoch = self._jobs.popleft()
            try:
                result: object = run_job(components, epoch, self._config, self._run_one)
            except BaseException as error:
                result = OptimisationCrashed(error)
            self._deliver(result)
