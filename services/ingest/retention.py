"""When features are dropped: the caps on a log's size and age, worked off in small steps.

Age is the time that ingest ran with an entry in its log, on a clock that nobody sets: a jump of
the wall clock, or months in a cupboard, drop nothing.

Source: decision 0029.
"""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Callable

from covinz.config import IngestConfig
from services.ingest.retained import Retained

logger = logging.getLogger(__name__)

# Between two looks while there is nothing to do; also how exactly ages are known. [s]
CHECK_S = 60.0
# Entries worked off between two groups of uploads: some milliseconds.
STEP_ENTRIES = 64
# Pages given back between two groups of uploads, once so many are free: 4 MiB. Fewer are kept for
# what comes next.
STEP_PAGES = 1024
DAY_S = 86_400.0


class Retention:
    """Keeps a log within `config.max_log_bytes` and `config.max_features_days`.

    Args:
        retained: What is in the log's file.
        head: Number of entries in the log now.
        config: The caps; without any nothing is ever done.
        clock_s: Monotonic time.
    """

    def __init__(
        self,
        retained: Retained,
        head: Callable[[], int],
        config: IngestConfig,
        clock_s: Callable[[], float],
    ) -> None:
        self._retained = retained
        self._head = head
        self._max_bytes = config.max_log_bytes
        self._max_age_s = config.max_features_days and config.max_features_days * DAY_S
        self._clock_s = clock_s
        self._noted_at_s = clock_s()
        self._next_s = self._noted_at_s
        self._said_full = False

    def patience_s(self) -> float | None:
        """How long `step` has nothing to do."""
        if self._max_bytes is None and self._max_age_s is None:
            return None
        return max(0.0, self._next_s - self._clock_s())

    def step(self) -> None:
        """Do a little of what is to be done."""
        if self.patience_s() != 0.0:
            return
        try:
            more = self._work()
        except sqlite3.Error as error:
            logger.error("cannot make room in the log: %s", error)
            more = False
        self._next_s = self._clock_s() + (0.0 if more else CHECK_S)

    def check_now(self) -> None:
        """The log has grown: look at its size with the next step."""
        if self._max_bytes is not None:
            self._next_s = min(self._next_s, self._clock_s())

    def _work(self) -> bool:
        """Whether there is more to do."""
        self._note_age()
        until = self._until()
        if until > self._retained.features_from:
            self._retained.drop_features(until)
            return True
        if self._retained.pages_to_give_back > STEP_PAGES:
            self._retained.give_back(STEP_PAGES)
            return True
        return False

    def _until(self) -> int:
        """Entries before this index are to lose their features now."""
        first, head = self._retained.features_from, self._head()
        next_few = min(first + STEP_ENTRIES, head)
        if self._max_bytes is not None and self._retained.used_bytes > self._max_bytes:
            if first == head and not self._said_full:
                self._said_full = True
                logger.warning(
                    "the poses alone take more than ingest.max_log_bytes; they are never dropped"
                )
            return next_few
        if self._max_age_s is not None:
            return max(first, min(next_few, self._retained.older_than(self._max_age_s)))
        return first

    def _note_age(self) -> None:
        now_s = self._clock_s()
        if self._max_age_s is not None and now_s - self._noted_at_s >= CHECK_S:
            self._retained.note_age(self._head(), now_s - self._noted_at_s)
            self._retained.forget_ages()
            self._noted_at_s = now_s
