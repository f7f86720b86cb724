"""Jobs that wait for a worker, the most useful one first.

First those that may join two maps, then those that bridge the longest way within one, then the
newest. The order decides who waits, never what comes of a job.

Source: decision 0028.
"""

from __future__ import annotations

import heapq

from covinz.types import LoopJob
from services.place_recognition.loop_graph import LoopGraph

# A small key is lent early.
Key = tuple[bool, float, int]


class Pending:
    """A queue whose order follows the accepted loops.

    With every accepted loop a waiting job can only become less useful. So the heap holds bounds,
    and a job that comes to its top is looked at again. Everything costs O(log n), but for
    `overflow`, which sorts.
    """

    def __init__(self, graph: LoopGraph) -> None:
        self._graph = graph
        self._jobs: dict[int, LoopJob] = {}
        self._heap: list[tuple[Key, int]] = []

    def __len__(self) -> int:
        return len(self._jobs)

    def add(self, number: int, job: LoopJob) -> None:
        """A job waits; `number` counts in order of creation."""
        self._jobs[number] = job
        heapq.heappush(self._heap, (self._key(number), number))

    def discard(self, number: int) -> None:
        """A job waits no more."""
        self._jobs.pop(number, None)
        if len(self._heap) > 2 * len(self._jobs) + 64:
            self._rebuild()

    def pop(self) -> int:
        """Take the most useful job out; IndexError when none waits."""
        while True:
            bound, number = heapq.heappop(self._heap)
            if number not in self._jobs:
                continue
            key = self._key(number)
            if key == bound:
                del self._jobs[number]
                return number
            heapq.heappush(self._heap, (key, number))

    def overflow(self, room: int) -> list[int]:
        """Take the least useful jobs out, so that `room` are left."""
        excess = sorted(self._jobs, key=self._key)[room:]
        for number in excess:
            del self._jobs[number]
        self._rebuild()
        return excess

    def _key(self, number: int) -> Key:
        job = self._jobs[number]
        if self._graph.is_between_maps(job.query, job.cand):
            return (False, 0.0, -number)
        return (True, -self._graph.way(job.query, job.cand), -number)

    def _rebuild(self) -> None:
        self._heap = [(self._key(number), number) for number in self._jobs]
        heapq.heapify(self._heap)
