"""Which segments belong together: the connected components over the loops."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz.types import KeyframeId, LoopClosure, SegmentId
from services.optimizer.segments import Segment


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """The whole input of one map, in canonical order.

    Attributes:
        segments: From the oldest (lowest first log_index) on; never empty.
        loops: By job id; both ends of each are in `segments`.
    """

    segments: tuple[Segment, ...]
    loops: tuple[LoopClosure, ...]

    @property
    def map_id(self) -> str:
        """Session of the oldest segment. Source: docs/conventions.md."""
        return self.segments[0].id.session

    @property
    def num_keyframes(self) -> int:
        """Nodes of its pose graph."""
        return sum(len(segment) for segment in self.segments)


def rows_of(
    component: Component, keyframes: Sequence[KeyframeId]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(L,) number of the segment and (L,) row in it of each keyframe; KeyError if there is none."""
    number = {
        (segment.id.agent, segment.id.session): i for i, segment in enumerate(component.segments)
    }
    segments = np.array([number[kf.agent, kf.session] for kf in keyframes], dtype=np.int64)
    seqs = np.array([kf.seq for kf in keyframes], dtype=np.int64)
    rows = np.empty_like(seqs)
    for i in np.unique(segments).tolist():
        rows[segments == i] = component.segments[i].rows(seqs[segments == i])
    return segments, rows


def segment_groups(
    first_log_index: Mapping[SegmentId, int], loops: Iterable[LoopClosure]
) -> list[tuple[tuple[SegmentId, ...], tuple[LoopClosure, ...]]]:
    """Connected components of segments over loops, oldest first, loops by job id.

    A function of its arguments as sets: the order of segments and loops does not matter.

    Raises:
        KeyError: If a loop names a segment that `first_log_index` has not.
    """
    ordered = sorted(loops, key=lambda loop: loop.job_id)
    parent = {segment: segment for segment in first_log_index}

    def root(segment: SegmentId) -> SegmentId:
        while parent[segment] != segment:
            parent[segment] = parent[parent[segment]]
            segment = parent[segment]
        return segment

    for loop in ordered:
        parent[root(loop.query.segment)] = root(loop.cand.segment)
    members: dict[SegmentId, list[SegmentId]] = {}
    for segment in sorted(first_log_index, key=first_log_index.__getitem__):
        members.setdefault(root(segment), []).append(segment)
    loops_of: dict[SegmentId, list[LoopClosure]] = {}
    for loop in ordered:
        loops_of.setdefault(root(loop.query.segment), []).append(loop)
    return [(tuple(group), tuple(loops_of.get(top, ()))) for top, group in members.items()]
