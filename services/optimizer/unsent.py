"""Corrections on their way out: none is sent before it is durable, none is lost to a full disk."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

from covinz.damage import Trouble
from covinz.types import Correction
from services.optimizer.loop_store import LoopStore, StoreUnavailable

logger = logging.getLogger(__name__)

# While the store cannot be written, e.g. since the disk is full, it is tried so often. [s]
RETRY_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Encoded:
    """A correction and its bytes: those that are stored are those that are sent."""

    correction: Correction
    payload: bytes


class Unsent:
    """The latest correction of each agent that waits for the store; for one thread.

    Attributes:
        retry_at_s: When the store is tried again; None while it works.
    """

    def __init__(self, store: LoopStore) -> None:
        self._store = store
        self._corrections: dict[str, Encoded] = {}
        self._trouble: Trouble | None = None
        self.retry_at_s: float | None = None

    def __bool__(self) -> bool:
        return bool(self._corrections) or self._trouble is not None

    @property
    def counters(self) -> dict[str, int]:
        """``cannot_store.<trouble>``: 1 while it lasts."""
        return {f"cannot_store.{self._trouble.value}": 1} if self._trouble else {}

    def of(self, agent: str) -> Correction | None:
        """What waits for an agent."""
        waiting = self._corrections.get(agent)
        return None if waiting is None else waiting.correction

    def add(self, agent: str, correction: Encoded) -> None:
        """A correction that the store was told of; it replaces the one before."""
        self._corrections[agent] = correction

    def write(self, change: Callable[[], None], now_s: float) -> None:
        """Change the store; if it cannot be written it remembers, and is tried again later."""
        try:
            change()
        except StoreUnavailable as error:
            self.failed(error, now_s)
        else:
            self._works_again()

    def failed(self, error: StoreUnavailable, now_s: float) -> None:
        """The store could not be written."""
        if self._trouble is not error.trouble:
            logger.error("loops and corrections wait: %s", error)
        self._trouble, self.retry_at_s = error.trouble, now_s + RETRY_S

    def take(self, now_s: float) -> list[Encoded]:
        """The corrections that are durable, by agent; each is given once."""
        if self.retry_at_s is not None and now_s >= self.retry_at_s:
            self.write(self._store.commit, now_s)
        if self._trouble is not None:
            return []
        taken = [self._corrections[agent] for agent in sorted(self._corrections)]
        self._corrections.clear()
        return taken

    def clear(self) -> None:
        """They are of a log that is forgotten."""
        self._corrections.clear()

    def _works_again(self) -> None:
        if self._trouble is not None:
            logger.warning("loops and corrections are stored again")
        self._trouble = self.retry_at_s = None
