"""How long things take in a process: distributions by name, for any number of threads."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

from covinz.bus import Query
from covinz.machine import THIS_MACHINE, Machine

# Upper ends of the classes that durations are counted in, both included. [s]
BUCKETS_S = (
    0.001,
    0.0025,
    0.005,
    0.01,
    0.025,
    0.05,
    0.1,
    0.25,
    0.5,
    1.0,
    2.5,
    5.0,
    10.0,
    30.0,
    60.0,
)


@dataclass(frozen=True, slots=True)
class Distribution:
    """Durations seen so far.

    Attributes:
        counts: How many in each class of `BUCKETS_S`, and how many were longer than all.
        sum_s: Of all of them.
    """

    counts: tuple[int, ...]
    sum_s: float


class Telemetry:
    """Counts durations by name."""

    def __init__(self, machine: Machine = THIS_MACHINE) -> None:
        self._clock_s = machine.monotonic_s
        self._lock = threading.Lock()  # never waits for anything, also not in the simulation
        self._counts: dict[str, list[int]] = {}
        self._sums_s: dict[str, float] = {}

    def observe(self, name: str, seconds: float) -> None:
        """Count one duration."""
        with self._lock:
            counts = self._counts.setdefault(name, [0] * (len(BUCKETS_S) + 1))
            counts[bisect_left(BUCKETS_S, seconds)] += 1
            self._sums_s[name] = self._sums_s.get(name, 0.0) + seconds

    def distributions(self) -> dict[str, Distribution]:
        """What was seen so far, by name."""
        with self._lock:
            return {
                name: Distribution(tuple(counts), self._sums_s[name])
                for name, counts in self._counts.items()
            }

    def timed(self, name: str, callback: Callable[[Query], None]) -> Callable[[Query], None]:
        """`callback`, whose questions are timed from their arrival to the reply."""

        def receive(query: Query) -> None:
            callback(_TimedQuery(query, name, self, self._clock_s))

        return receive


class _TimedQuery:
    """A question that tells how long it waited when it is answered."""

    def __init__(
        self, query: Query, name: str, telemetry: Telemetry, clock_s: Callable[[], float]
    ) -> None:
        self.key = query.key
        self.payload = query.payload
        self._query = query
        self._name = name
        self._telemetry = telemetry
        self._clock_s = clock_s
        self._since_s = clock_s()

    def reply(self, payload: bytes) -> None:
        self._telemetry.observe(self._name, self._clock_s() - self._since_s)
        self._query.reply(payload)

    def drop(self) -> None:
        self._query.drop()
