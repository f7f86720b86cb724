"""What the accepted loops join so far: which sessions share a map, and how long the ways are.

The dispatcher's own, rough view of the maps, for the order of jobs only: it counts keyframes along
sessions and knows no poses. Ways only get shorter and maps only grow with every loop.

Source: decision 0028.
"""

from __future__ import annotations

import math
from collections import defaultdict

from covinz.types import KeyframeId, SegmentId

# A loop so near to a known one, in keyframes, shortens no way that matters.
NEGLIGIBLE_KEYFRAMES = 5


class LoopGraph:
    """Sessions as chains of keyframes, and loops between them."""

    def __init__(self) -> None:
        self._parents: dict[SegmentId, SegmentId] = {}
        # Loops by pair of sessions, lower one first: sequence numbers in that order.
        self._loops: defaultdict[tuple[SegmentId, SegmentId], list[tuple[int, int]]]
        self._loops = defaultdict(list)

    def join(self, query: KeyframeId, cand: KeyframeId) -> None:
        """Take an accepted loop in."""
        if self.way(query, cand) > NEGLIGIBLE_KEYFRAMES:
            low, high = sorted((query, cand))
            self._loops[low.segment, high.segment].append((low.seq, high.seq))
        self._parents[self._root(query.segment)] = self._root(cand.segment)

    def is_between_maps(self, query: KeyframeId, cand: KeyframeId) -> bool:
        """Whether a loop between two keyframes would join two maps."""
        return self._root(query.segment) != self._root(cand.segment)

    def way(self, query: KeyframeId, cand: KeyframeId) -> float:
        """Keyframes between two keyframes, along their sessions and at most one loop.

        Infinite for two sessions that no loop joins directly.
        """
        low, high = sorted((query, cand))
        direct = high.seq - low.seq if low.segment == high.segment else math.inf
        loops = self._loops.get((low.segment, high.segment), ())
        over = (abs(low.seq - a) + abs(high.seq - b) for a, b in loops)
        return min(direct, min(over, default=math.inf))

    def _root(self, segment: SegmentId) -> SegmentId:
        root = segment
        while (parent := self._parents.get(root, root)) != root:
            root = parent
        while segment != root:  # shorten the path for next time
            self._parents[segment], segment = root, self._parents.get(segment, root)
        return root
