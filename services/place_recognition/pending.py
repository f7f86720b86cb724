"""Jobs that wait for a worker, the most useful one first.

First those that may join two maps, then those that bridge the longest way within one, then the
newest. Of the few most useful ones a worker gets the one that suits it best. The order decides who
waits, never what comes of a job.

Source: decisions 0028 and 0036.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable

from covinz.types import LoopJob
from services.place_recognition.loop_graph import LoopGraph

# A small key is lent early.
Key = tuple[bool, float, int]
Entry = tuple[Key, int]

# A worker may choose among so many, and the first of them is passed over so often at most.
# [simulated, two workers: 4 save a fifth of what the second one fetches, 8 two thirds; 0036]
CHOICE = 8


class Pending:
    """A queue whose order follows the accepted loops.

    With every accepted loop a waiting job can only become less useful. So the heap holds bounds,
    and a job that comes to its top is looked at again. Everything costs O(log n), but for
    `overflow`, which sorts.
    """

    def __init__(self, graph: LoopGraph) -> None:
        self._graph = graph
        self._jobs: dict[int, LoopJob] = {}
        self._heap: list[Entry] = []
        # The most useful job when one was taken last, and how often it was passed over.
        self._passed = (-1, 0)

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

    def pop(self, suits: Callable[[LoopJob], int] = lambda _: 0) -> int:
        """Take a job out: of the most useful ones that which suits best, of equal ones the first.

        A job that may join two maps goes before all that may not.

        Args:
            suits: How well a job suits who asks; more is better.

        Raises:
            IndexError: When none waits.
        """
        most_useful = self._top()
        others = self._some_like(most_useful)
        chosen = max((most_useful, *others), key=lambda entry: suits(self._jobs[entry[1]]))
        chosen = self._unless_passed_over(most_useful, chosen)
        for entry in (most_useful, *others):
            if entry is not chosen:
                heapq.heappush(self._heap, entry)
        del self._jobs[chosen[1]]
        return chosen[1]

    def overflow(self, room: int) -> list[int]:
        """Take the least useful jobs out, so that `room` are left."""
        excess = sorted(self._jobs, key=self._key)[room:]
        for number in excess:
            del self._jobs[number]
        self._rebuild()
        return excess

    def _top(self) -> Entry:
        """Take the most useful job off the heap; IndexError when none waits."""
        while True:
            bound, number = heapq.heappop(self._heap)
            if number not in self._jobs:
                continue
            key = self._key(number)
            if key == bound:
                return key, number
            heapq.heappush(self._heap, (key, number))

    def _some_like(self, first: Entry) -> list[Entry]:
        """Take the next most useful ones off the heap, if they are of the same kind."""
        entries: list[Entry] = []
        while self._heap and len(entries) < CHOICE - 1:
            try:
                entry = self._top()
            except IndexError:
                break
            if entry[0][0] != first[0][0]:
                heapq.heappush(self._heap, entry)
                break
            entries.append(entry)
        return entries

    def _unless_passed_over(self, most_useful: Entry, chosen: Entry) -> Entry:
        """What is taken: the most useful one if others went before it too often already."""
        last, count = self._passed
        count = count + 1 if last == most_useful[1] else 1
        if chosen is most_useful or count > CHOICE:
            return most_useful
        self._passed = (most_useful[1], count)
        return chosen

    def _key(self, number: int) -> Key:
        job = self._jobs[number]
        if self._graph.is_between_maps(job.query, job.cand):
            return (False, 0.0, -number)
        return (True, -self._graph.way(job.query, job.cand), -number)

    def _rebuild(self) -> None:
        self._heap = [(self._key(number), number) for number in self._jobs]
        heapq.heapify(self._heap)
