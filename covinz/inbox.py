"""The one bounded queue in front of the thread that owns a process's state."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from covinz.machine import THIS_MACHINE, Machine
from covinz.watch import Work

# Events that wait for the owner thread; beyond it senders wait or are turned away.
INBOX_CAPACITY = 1024


class Stopped(Exception):
    """The process was asked to stop: clean up and return."""


class Inbox:
    """What waits for the owner thread: bounded, first in first out, filled by any thread.

    Args:
        capacity: Events that may wait.
        on_first_take: Called once, by the owner, before its first look into the inbox.
        machine: To wait.
        owner: What the owner does between two looks; it is not stuck while it waits here.
    """

    def __init__(
        self,
        capacity: int = INBOX_CAPACITY,
        on_first_take: Callable[[], object] | None = None,
        machine: Machine = THIS_MACHINE,
        owner: Work | None = None,
    ) -> None:
        if capacity < 1:
            raise ValueError(f"an inbox of {capacity} events can hold nothing")
        self._capacity = capacity
        self._on_first_take = on_first_take
        self._owner = owner
        self._changed = machine.condition()
        self._events: deque[object] = deque()
        self._stopping = False

    def put(self, event: object, block: bool = True) -> bool:
        """Add an event; whether it was taken in.

        False once a stop was requested, or when the inbox is full and `block` is False. Otherwise
        a full inbox makes the sender wait. The owner thread itself must not block here.
        """
        with self._changed:
            if block:
                self._changed.wait_for(lambda: self._stopping or len(self._events) < self._capacity)
            if self._stopping or len(self._events) >= self._capacity:
                return False
            self._append(event)
            return True

    def put_always(self, event: object) -> bool:
        """Add a rare, small event even when the inbox is full; False once stopping."""
        with self._changed:
            if self._stopping:
                return False
            self._append(event)
            return True

    def take(self, timeout_s: float | None) -> object | None:
        """The next event, or None when there is none within `timeout_s` (None: wait on).

        Raises:
            Stopped: Once a stop was requested, whatever still waits.
        """
        if self._on_first_take is not None:
            on_first_take, self._on_first_take = self._on_first_take, None
            on_first_take()
        if self._owner is not None:
            self._owner.end()
        with self._changed:
            self._changed.wait_for(lambda: self._stopping or self._events, timeout_s)
            if self._owner is not None:
                self._owner.begin()
            if self._stopping:
                raise Stopped
            if not self._events:
                return None
            return self._pop()

    def drain(self, limit: int) -> list[object]:
        """Up to `limit` events that are there now; never waits and never raises."""
        with self._changed:
            return [self._pop() for _ in range(min(limit, len(self._events)))]

    def stop(self) -> None:
        """Ask the owner to stop: `take` raises, nothing more is let in."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()

    @property
    def is_stopping(self) -> bool:
        """Whether a stop was requested."""
        return self._stopping

    def __len__(self) -> int:
        with self._changed:
            return len(self._events)

    def _append(self, event: object) -> None:
        self._events.append(event)
        self._changed.notify_all()

    def _pop(self) -> object:
        event = self._events.popleft()
        self._changed.notify_all()
        return event
