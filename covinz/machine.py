"""What a process takes from its machine: clocks, chance and threads.

Everything that waits, looks at a clock or draws at random gets a `Machine`, so that the same code
runs in the deterministic simulation of tests/simulation, where a seed decides who runs when.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Protocol

from covinz.niceness import LONG_TURNS_S, take_turns


class Lock(Protocol):
    """Mutual exclusion of the threads of one process: ``with lock: ...``."""

    def __enter__(self) -> bool:
        """Wait for it and take it."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
        /,
    ) -> None:
        """Give it back."""


class Condition(Lock, Protocol):
    """As `threading.Condition`."""

    def wait(self, timeout: float | None = None) -> bool:
        """Give the lock back until `notify_all`; False when time ran out first."""

    def wait_for(self, predicate: Callable[[], Any], timeout: float | None = None) -> Any:
        """Wait until `predicate` is true or time ran out; its last value."""

    def notify_all(self) -> None:
        """Wake all who wait."""


class Event(Protocol):
    """As `threading.Event`."""

    def is_set(self) -> bool:
        """Whether it has happened."""

    def set(self) -> None:
        """It happens: wake all who wait."""

    def clear(self) -> None:
        """It has not happened yet."""

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it happens; False when time ran out first."""


class Machine(Protocol):
    """Clocks, chance and threads of one process."""

    def monotonic_s(self) -> float:
        """Seconds of a clock that nobody sets."""

    def now_ns(self) -> int:
        """Nanoseconds since the Unix epoch."""

    def random_bytes(self, count: int) -> bytes:
        """Bytes that nobody can foretell."""

    def lock(self) -> Lock:
        """A new lock."""

    def condition(self) -> Condition:
        """A new condition with a lock of its own."""

    def event(self) -> Event:
        """A new event that has not happened."""

    def thread(
        self,
        target: Callable[[], object],
        name: str,
        daemon: bool = False,
        computes: bool = False,
    ) -> threading.Thread:
        """A thread that has not been started; `computes`: others that are woken go before it."""


class ThisMachine:
    """The machine that the program runs on."""

    def monotonic_s(self) -> float:
        """See `Machine.monotonic_s`."""
        return time.monotonic()

    def now_ns(self) -> int:
        """See `Machine.now_ns`."""
        return time.time_ns()

    def random_bytes(self, count: int) -> bytes:
        """See `Machine.random_bytes`."""
        return secrets.token_bytes(count)

    def lock(self) -> Lock:
        """See `Machine.lock`."""
        return threading.Lock()

    def condition(self) -> Condition:
        """See `Machine.condition`."""
        return threading.Condition()

    def event(self) -> Event:
        """See `Machine.event`."""
        return threading.Event()

    def thread(
        self,
        target: Callable[[], object],
        name: str,
        daemon: bool = False,
        computes: bool = False,
    ) -> threading.Thread:
        """See `Machine.thread`."""

        def run() -> None:
            take_turns(LONG_TURNS_S)
            target()

        return threading.Thread(target=run if computes else target, name=name, daemon=daemon)


THIS_MACHINE = ThisMachine()
