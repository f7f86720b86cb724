"""The maps: keyframes and loops in, what is published out. Knows what is not yet reflected.

Two sides: the inputs (segments and loops, whose components are the maps there should be) and the
published maps (the estimates applied last). A component is stale when the published map is not the
function of it that decision 0003 makes it; nothing else is remembered about what is dirty.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from covinz.config import OptimizerConfig
from covinz.types import (
    Keyframe,
    KeyframeId,
    LoopClosure,
    MapList,
    MapSnapshot,
    MapSummary,
    SegmentId,
)
from services.optimizer.components import Component, segment_groups
from services.optimizer.optimisation import MapEstimate, Placement, optimise
from services.optimizer.pose_graph import build_graph, keyframe_ids
from services.optimizer.segments import GrowingSegment

# So many keyframes of one session in a row, and the agent is in that session: uploads that are
# under way together overtake each other, but not so far. [`agent.window`]
SWITCH_AFTER = 4

Group = tuple[tuple[SegmentId, ...], tuple[LoopClosure, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class PublishedMap:
    """An estimate and the number under which it was published."""

    estimate: MapEstimate
    revision: int


class Maps:
    """State of the optimizer; for its owner thread."""

    def __init__(self, config: OptimizerConfig) -> None:
        self._config = config
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._segments: dict[SegmentId, GrowingSegment] = {}
        self._newest: dict[str, SegmentId] = {}
        # The segment of each agent's last keyframe and how many in a row were of it.
        self._run: dict[str, tuple[SegmentId, int]] = {}
        self._loops: dict[str, LoopClosure] = {}
        self._pending: dict[str, LoopClosure] = {}
        self._waits_for: dict[KeyframeId, set[str]] = {}
        self._groups: list[Group] | None = None
        self._published: dict[SegmentId, PublishedMap] = {}

    # --- inputs ------------------------------------------------------------------------------

    def add_keyframe(self, log_index: int, keyframe: Keyframe, revision: int) -> bool:
        """Take a keyframe in log order; True when the agent's segment has become this one.

        That is so with the first keyframe of a segment.

        A new segment is a map of its own, published under `revision`, until a loop joins it.
        """
        segment = keyframe.id.segment
        is_new = segment not in self._segments
        growing = self._segments.setdefault(segment, GrowingSegment(segment))
        growing.add(log_index, keyframe)
        if is_new:
            self._groups = None
            alone = Component((growing.frozen(),), ())
            self._published[segment] = PublishedMap(optimise(alone, self._config), revision)
        for job_id in sorted(self._waits_for.pop(keyframe.id, ())):
            self._try_pending(job_id)
        return self._follow(segment, is_new)

    def add_loop(self, loop: LoopClosure) -> None:
        """Take a loop; it waits until both its keyframes are there."""
        self._pending[loop.job_id] = loop
        self._try_pending(loop.job_id)

    def remove_loop(self, job_id: str) -> None:
        """Take a loop out again."""
        if self._loops.pop(job_id, None) is not None:
            self._groups = None

    @property
    def pending(self) -> frozenset[str]:
        """Job ids of loops that wait for keyframes."""
        return frozenset(self._pending)

    @property
    def num_keyframes(self) -> int:
        """Keyframes of all segments."""
        return sum(len(segment) for segment in self._segments.values())

    @property
    def num_loops(self) -> int:
        """Loops with both their keyframes."""
        return len(self._loops)

    # --- what there should be and what there is ----------------------------------------------

    def stale(self, with_keyframes: bool) -> list[Group]:
        """Components whose map is not published as it should be, oldest first.

        Args:
            with_keyframes: Also those that only have new keyframes. A map without loops never
                is one of them: its odometry is its optimum.
        """
        return [
            (segments, loops)
            for segments, loops in self._all_groups()
            if self._is_stale(segments, loops, with_keyframes)
        ]

    def component(self, group: Group) -> Component:
        """An immutable copy of what one map is made of."""
        segments, loops = group
        return Component(tuple(self._segments[name].frozen() for name in segments), loops)

    def apply(self, estimate: MapEstimate, revision: int) -> bool:
        """Publish an estimate; False, and no change, when its component is no longer one."""
        segments = tuple(estimate.placements)
        if all(segments != group for group, _ in self._all_groups()):
            return False
        members = set(segments)
        overlapping = [
            oldest
            for oldest, published in self._published.items()
            if not members.isdisjoint(published.estimate.placements)
        ]
        for oldest in overlapping:
            del self._published[oldest]
        self._published[segments[0]] = PublishedMap(estimate, revision)
        return True

    # --- what is published -------------------------------------------------------------------

    def map_list(self) -> MapList:
        """All maps, oldest first."""
        return MapList(tuple(self._summary(published) for published in self._in_order()))

    def snapshot(self, map_id: str) -> MapSnapshot | None:
        """One map with its graph; None when there is none of that id.

        Keyframes newer than the estimate are placed by their odometry.
        """
        for published in self._in_order():
            if published.estimate.map_id == map_id:
                return self._snapshot(published)
        return None

    def placement(self, segment: SegmentId) -> tuple[PublishedMap, Placement] | None:
        """The map that a segment is in and where; None while it is in none."""
        for published in self._published.values():
            if segment in published.estimate.placements:
                return published, published.estimate.placements[segment]
        return None

    def newest_segments(self) -> Iterable[SegmentId]:
        """The segment that every agent is in, sorted by agent.

        It is the one that began last in the log, until `SWITCH_AFTER` keyframes in a row show that
        it was another.
        """
        return [self._newest[agent] for agent in sorted(self._newest)]

    # --- inside ------------------------------------------------------------------------------

    def _follow(self, segment: SegmentId, is_new: bool) -> bool:
        """Note whose keyframe came; whether the agent's newest segment has become this one."""
        last, count = self._run.get(segment.agent, (segment, 0))
        count = count + 1 if last == segment else 1
        self._run[segment.agent] = segment, count
        if not is_new and (count < SWITCH_AFTER or self._newest[segment.agent] == segment):
            return False
        self._newest[segment.agent] = segment
        return True

    def _try_pending(self, job_id: str) -> None:
        loop = self._pending[job_id]
        for keyframe in (loop.query, loop.cand):
            segment = self._segments.get(keyframe.segment)
            if segment is None or keyframe not in segment:
                self._waits_for.setdefault(keyframe, set()).add(job_id)
                return
        self._loops[job_id] = self._pending.pop(job_id)
        self._groups = None

    def _all_groups(self) -> list[Group]:
        if self._groups is None:
            first = {name: segment.first_log_index for name, segment in self._segments.items()}
            self._groups = segment_groups(first, self._loops.values())
        return self._groups

    def _is_stale(
        self,
        segments: tuple[SegmentId, ...],
        loops: tuple[LoopClosure, ...],
        with_keyframes: bool,
    ) -> bool:
        published = self._published.get(segments[0])
        if published is None:
            return True
        estimate = published.estimate
        if tuple(estimate.placements) != segments or estimate.loops != loops:
            return True
        if not (with_keyframes and loops):
            return False
        return len(estimate.log_index) != sum(len(self._segments[name]) for name in segments)

    def _in_order(self) -> list[PublishedMap]:
        by_age = sorted(self._published, key=lambda name: self._segments[name].first_log_index)
        return [self._published[name] for name in by_age]

    def _summary(self, published: PublishedMap) -> MapSummary:
        segments = tuple(published.estimate.placements)
        return MapSummary(
            map_id=published.estimate.map_id,
            revision=published.revision,
            segments=segments,
            num_keyframes=sum(len(self._segments[name]) for name in segments),
            num_loops=len(published.estimate.loops),
        )

    def _snapshot(self, published: PublishedMap) -> MapSnapshot:
        estimate = published.estimate
        component = self.component((tuple(estimate.placements), estimate.loops))
        graph = build_graph(component, self._config)
        T_map_odom = np.array([place.T_map_odom for place in estimate.placements.values()])
        T_map_body = T_map_odom[graph.segment] @ graph.T_odom_body
        T_map_body[np.searchsorted(graph.log_index, estimate.log_index)] = estimate.T_map_body
        return MapSnapshot(
            summary=self._summary(published),
            keyframes=keyframe_ids(graph, component),
            stamps_ns=graph.stamp_ns,
            T_map_body=T_map_body,
            T_odom_body=graph.T_odom_body,
            edge_from=graph.edge_from,
            edge_to=graph.edge_to,
            T_from_to=graph.T_from_to,
            information=graph.information,
            is_loop=graph.is_loop,
        )
