"""Threads of which one runs at a time: a seed decides which, and when time goes on.

A simulated thread is a greenlet: it runs until it blocks, and then the scheduler picks the next
one; when nobody can run, the clock moves on to the next timed event. Nothing in here looks at a
real clock, so that the same seed gives the same run.
"""

from __future__ import annotations

import heapq
import itertools
import random
import threading
from collections.abc import Callable

from greenlet import greenlet

# A step of a thread takes between these times. [s]
MIN_STEP_S, MAX_STEP_S = 1e-5, 3e-4


class Killed(BaseException):
    """The simulated process of this thread is dead: unwind, with no effect on anything."""


class SimulationError(AssertionError):
    """The simulation itself was used in a way that it cannot simulate."""


class Task(threading.Thread):
    """A simulated thread; no thread of the operating system is ever started for it.

    Attributes:
        is_dead: Whether its process was killed.
        is_frozen: Whether its process hangs.
        waits: How often it has blocked: tells a timer of an earlier wait from this one's.
        was_woken: Its last wait did not end because time ran out.
        held: Number of locks that it holds.
        is_over: It has ended.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        target: Callable[[], object],
        name: str,
        is_dead: Callable[[], bool],
        is_frozen: Callable[[], bool],
    ) -> None:
        super().__init__(name=name, daemon=True)
        self.is_dead = is_dead
        self.is_frozen = is_frozen
        self.waits = 0
        self.was_woken = False
        self.held = 0
        self.is_over = False
        self.body = greenlet(self._live)
        self._scheduler = scheduler
        self._do = target
        self._has_started = False
        self._joining: list[Task] = []

    def start(self) -> None:
        """See `threading.Thread.start`; it runs when the scheduler lets it."""
        if self.is_dead():
            raise Killed
        self._has_started = True
        self._scheduler.adopt(self)

    def join(self, timeout: float | None = None) -> None:
        """See `threading.Thread.join`."""
        if self.is_alive():
            self._scheduler.park(self._joining, timeout)

    def is_alive(self) -> bool:
        """See `threading.Thread.is_alive`."""
        return self._has_started and not self.is_over

    def _live(self) -> None:
        try:
            if not self.is_dead():
                self._do()
        except Killed:
            pass
        except BaseException as error:
            self._scheduler.fail(f"thread {self.name} ended with {error!r}")
        self.is_over = True
        self._scheduler.wake_all(self._joining)


class Scheduler:
    """The clock, what is due when, and who may run.

    Attributes:
        now_s: Time since the beginning.
        steps: Times that a thread was resumed.
        failure: What went wrong first, if anything did.
        current: The thread that runs; None in calls of `at`.
    """

    def __init__(self, draw: random.Random) -> None:
        self.now_s = 0.0
        self.steps = 0
        self.failure: str | None = None
        self.current: Task | None = None
        self._draw = draw
        self._numbers = itertools.count()
        self._events: list[tuple[float, int, Callable[[], object]]] = []
        self._ready: list[Task] = []
        self._tasks: list[Task] = []
        self._root = greenlet.getcurrent()

    # --- for whoever runs the simulation -------------------------------------------------------

    def run(self, until: Callable[[], bool], limit_s: float) -> bool:
        """Let threads run until `until()` or a failure; False when `limit_s` came first."""
        while self.failure is None and not until():
            if self.now_s > limit_s:
                return False
            self._step()
        return until()

    def finish(self) -> None:
        """Let the threads unwind, all of whose processes are dead."""
        self._events.clear()
        while any(task.is_alive() for task in self._tasks):
            if not self._ready:
                raise SimulationError("a thread of a process that still lives")
            self._step()

    def fail(self, text: str) -> None:
        """Note what went wrong; the run ends with the first failure."""
        if self.failure is None:
            self.failure = f"at {self.now_s:.3f} s: {text}"

    def at(self, time_s: float, call: Callable[[], object]) -> None:
        """Call something at a time, outside of any thread; it must not block."""
        heapq.heappush(self._events, (max(time_s, self.now_s), next(self._numbers), call))

    def after(self, seconds: float, call: Callable[[], object]) -> None:
        """Call something so much later."""
        self.at(self.now_s + seconds, call)

    # --- for threads ---------------------------------------------------------------------------

    def adopt(self, task: Task) -> None:
        """A thread has been started."""
        self._tasks.append(task)
        self._ready.append(task)

    def park(self, waiters: list[Task], timeout_s: float | None) -> bool:
        """Block the thread that runs until `wake_all(waiters)`; False when time ran out first."""
        task = self.current
        if task is None:
            raise SimulationError("a callback of the bus, or the simulation itself, would block")
        if task.is_dead():
            raise Killed
        task.waits += 1
        task.was_woken = False
        waiters.append(task)
        if timeout_s is not None:
            number = task.waits
            self.after(max(0.0, timeout_s), lambda: self._time_out(task, number))
        self._leave(task)
        if task in waiters:
            waiters.remove(task)
        return task.was_woken

    def wake_all(self, waiters: list[Task]) -> None:
        """Let all that wait there go on, some time."""
        for task in waiters:
            task.was_woken = True
            self._make_ready(task)
        waiters.clear()

    def pause(self) -> None:
        """Let others run now, if there are any."""
        task = self.current
        if task is not None:
            task.waits += 1
            self._ready.append(task)
            self._leave(task)

    def release_dead(self, tasks: list[Task]) -> None:
        """Let the threads of a process that was just killed unwind."""
        for task in tasks:
            if task.is_alive():
                self._make_ready(task)

    # --- inside --------------------------------------------------------------------------------

    def _time_out(self, task: Task, number: int) -> None:
        if task.waits == number and task.is_alive():
            self._make_ready(task)

    def _make_ready(self, task: Task) -> None:
        if task not in self._ready and task is not self.current:
            self._ready.append(task)

    def _leave(self, task: Task) -> None:
        """Give the processor away until it is this thread's turn again."""
        self._root.switch()
        if task.is_dead():
            raise Killed

    def _step(self) -> None:
        """Do what is due, then let one thread run; or let time go on to what is due next."""
        while self._events and self._events[0][0] <= self.now_s:
            self._call(heapq.heappop(self._events)[2])
        able = [task for task in self._ready if task.is_dead() or not task.is_frozen()]
        if able:
            task = able[self._draw.randrange(len(able))]
            self._ready.remove(task)
            self.steps += 1
            self.now_s += self._draw.uniform(MIN_STEP_S, MAX_STEP_S)
            self.current = task
            task.body.switch()
            self.current = None
        elif self._events:
            self.now_s = self._events[0][0]
        else:
            self.fail("everybody waits, for nothing")

    def _call(self, call: Callable[[], object]) -> None:
        try:
            call()
        except Killed:
            pass
        except BaseException as error:
            self.fail(f"a callback failed with {error!r}")
