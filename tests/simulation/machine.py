"""The machine that a simulated process runs on: virtual time, seeded chance, scheduled threads."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any

from tests.simulation.scheduler import Killed, Scheduler, SimulationError, Task

# When the simulation begins, by the wall clock.
EPOCH_NS = 1_800_000_000 * 10**9
# How often a thread lets others run where it need not: around locks, before and after questions.
SWITCH_PROBABILITY = 0.1
CALLBACK = "callback"


class SimulatedMachine:
    """One run of one process; see `covinz.machine.Machine`.

    Attributes:
        name: Of the process.
        is_dead: It was killed: whatever its threads still do has no effect.
        is_frozen: It hangs: no thread of it runs.
        clock_offset_ns: Error of its wall clock.
    """

    def __init__(self, scheduler: Scheduler, name: str, seed: int) -> None:
        self.scheduler = scheduler
        self.name = name
        self.is_dead = False
        self.is_frozen = False
        self.clock_offset_ns = 0
        self.tasks: list[Task] = []
        self._draw = random.Random(seed)

    def monotonic_s(self) -> float:
        """See `Machine.monotonic_s`."""
        self.check()
        return self.scheduler.now_s

    def now_ns(self) -> int:
        """See `Machine.now_ns`."""
        return EPOCH_NS + self.clock_offset_ns + int(self.scheduler.now_s * 1e9)

    def random_bytes(self, count: int) -> bytes:
        """See `Machine.random_bytes`."""
        return self._draw.randbytes(count)

    def lock(self) -> SimulatedLock:
        """See `Machine.lock`."""
        return SimulatedLock(self)

    def condition(self) -> SimulatedCondition:
        """See `Machine.condition`."""
        return SimulatedCondition(self)

    def event(self) -> SimulatedEvent:
        """See `Machine.event`."""
        return SimulatedEvent(self)

    def thread(
        self,
        target: Callable[[], object],
        name: str,
        daemon: bool = False,
        computes: bool = False,
    ) -> threading.Thread:
        """See `Machine.thread`."""
        task = Task(
            self.scheduler,
            target,
            f"{self.name}/{name}",
            lambda: self.is_dead,
            lambda: self.is_frozen,
        )
        self.tasks.append(task)
        return task

    def sleep(self, seconds: float) -> None:
        """Wait so long."""
        self.scheduler.park([], seconds)

    def check(self) -> None:
        """Raise Killed in a dead process."""
        if self.is_dead:
            raise Killed

    def point(self) -> None:
        """A place where another thread may run, if the seed says so."""
        self.check()
        task = self.scheduler.current
        if task is not None and not task.held and self._draw.random() < SWITCH_PROBABILITY:
            self.scheduler.pause()

    def die(self) -> None:
        """All threads end at once, where they are."""
        self.is_dead = True
        self.scheduler.release_dead(self.tasks)


class SimulatedLock:
    """See `covinz.machine.Lock`; the same thread may take a condition's again."""

    def __init__(self, machine: SimulatedMachine, is_reentrant: bool = False) -> None:
        self._machine = machine
        self._is_reentrant = is_reentrant
        self._owner: object = None
        self._depth = 0
        self._waiters: list[Task] = []

    def __enter__(self) -> bool:
        self._machine.point()
        self._acquire()
        return True

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._machine.is_dead:
            return
        self._release()
        if kind is None:
            self._machine.point()

    def _acquire(self) -> None:
        me = self._me()
        while self._owner is not None and not (self._is_reentrant and self._owner is me):
            if self._owner is me:
                raise SimulationError("a thread waits for a lock that it holds")
            self._machine.scheduler.park(self._waiters, None)
        self._owner = me
        self._depth += 1
        if isinstance(me, Task):
            me.held += 1

    def _release(self) -> None:
        me = self._me()
        if self._owner is not me:
            raise SimulationError("a lock is given back by a thread that does not hold it")
        if isinstance(me, Task):
            me.held -= 1
        self._depth -= 1
        if not self._depth:
            self._owner = None
            self._machine.scheduler.wake_all(self._waiters)

    def _me(self) -> object:
        return self._machine.scheduler.current or CALLBACK


class SimulatedCondition(SimulatedLock):
    """See `covinz.machine.Condition`."""

    def __init__(self, machine: SimulatedMachine) -> None:
        super().__init__(machine, is_reentrant=True)
        self._sleepers: list[Task] = []

    def wait(self, timeout: float | None = None) -> bool:
        """See `Condition.wait`."""
        if self._depth != 1 or self._owner is not self._me():
            raise SimulationError("only who holds a condition once may wait for it")
        self._release()
        woken = self._machine.scheduler.park(self._sleepers, timeout)
        self._acquire()
        return woken

    def wait_for(self, predicate: Callable[[], Any], timeout: float | None = None) -> Any:
        """See `Condition.wait_for`."""
        end_s = None if timeout is None else self._machine.monotonic_s() + timeout
        while not (value := predicate()):
            left_s = None if end_s is None else end_s - self._machine.monotonic_s()
            if left_s is not None and left_s <= 0:
                return value
            self.wait(left_s)
        return value

    def notify_all(self) -> None:
        """See `Condition.notify_all`."""
        self._machine.check()
        self._machine.scheduler.wake_all(self._sleepers)


class SimulatedEvent:
    """See `covinz.machine.Event`."""

    def __init__(self, machine: SimulatedMachine) -> None:
        self._machine = machine
        self._is_set = False
        self._waiters: list[Task] = []

    def is_set(self) -> bool:
        """See `Event.is_set`."""
        self._machine.check()
        return self._is_set

    def set(self) -> None:
        """See `Event.set`."""
        self._machine.check()
        self._is_set = True
        self._machine.scheduler.wake_all(self._waiters)

    def clear(self) -> None:
        """See `Event.clear`."""
        self._machine.check()
        self._is_set = False

    def wait(self, timeout: float | None = None) -> bool:
        """See `Event.wait`."""
        self._machine.point()
        if not self._is_set:
            self._machine.scheduler.park(self._waiters, timeout)
        return self._is_set
