"""What a process tells about itself: log lines, counters and the time that its stages take."""

from __future__ import annotations

import logging
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

logger = logging.getLogger(__name__)

# Durations that the statistics of a stage are made of: the last ones.
MAX_DURATIONS = 512


class Telemetry:
    """Counters and stage times by name, for any number of threads.

    Args:
        clock_s: Seconds, monotonic.
    """

    def __init__(self, clock_s: Callable[[], float] = time.perf_counter) -> None:
        self._clock_s = clock_s
        self._lock = threading.Lock()
        self._counters: defaultdict[str, float] = defaultdict(float)
        self._durations_ms: defaultdict[str, deque[float]] = defaultdict(
            lambda: deque(maxlen=MAX_DURATIONS)
        )

    def count(self, name: str, amount: float = 1.0) -> None:
        """Add to a counter, which starts at 0."""
        with self._lock:
            self._counters[name] += amount

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block, whether or not it raises."""
        began_s = self._clock_s()
        try:
            yield
        finally:
            duration_ms = 1e3 * (self._clock_s() - began_s)
            with self._lock:
                self._durations_ms[name].append(duration_ms)

    def snapshot(self) -> dict[str, float]:
        """For `Status.counters`: counters, and of each stage ``{name}_ms.median`` and ``.p95``."""
        with self._lock:
            values = dict(self._counters)
            for name, durations_ms in self._durations_ms.items():
                ordered = sorted(durations_ms)
                values[f"{name}_ms.median"] = quantile(ordered, 0.5)
                values[f"{name}_ms.p95"] = quantile(ordered, 0.95)
        return dict(sorted(values.items()))


def quantile(ordered: list[float], q: float) -> float:
    """Quantile of sorted, non-empty values, linear between them."""
    position = q * (len(ordered) - 1)
    low = int(position)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (position - low) * (ordered[high] - ordered[low])
