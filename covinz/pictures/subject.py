"""What the pictures of a run show: every robot's path before and after, truth, loops and plan.

Where a map has ground truth, all of it is in the world frame: the map aligned to it once, and each
odometry laid into it by the true pose of its first keyframe, so that its drift shows. Elsewhere the
map is in its own frame and each odometry starts at the origin, with the map's directions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz import evaluation, export, frames
from covinz.loop_edges import LoopEdges, loop_edges
from covinz.record import RunRecord
from covinz.trajectory import Trajectory
from covinz.types import Array, KeyframeId, MapSnapshot, SegmentId


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The keyframes of one segment, in order, and the truth along them.

    Attributes:
        agent: Whose.
        keyframes: (N,) index in the map's snapshot.
        stamps_ns: (N,) int64.
        before_m: (N, 3) positions of the odometry alone.
        after_m: (N, 3) positions in the map.
        true_m: (N, 3) true positions; NaN where there is none.
        truth_m: (K, 3) the true path from the first keyframe to the last, finely; may be empty.
    """

    agent: str
    keyframes: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    before_m: Array
    after_m: Array
    true_m: Array
    truth_m: Array


@dataclass(frozen=True, slots=True, eq=False)
class MapSubject:
    """One map.

    Attributes:
        tracks: Its segments, in the order of agents.
        aligned: Whether it is in the world frame.
        loops: Its loop edges.
        loop_ends_m: (L, 2, 3) positions of their two ends in the map.
        inter: (L,) bool: loops between two agents.
    """

    tracks: Sequence[Track]
    aligned: bool
    loops: LoopEdges
    loop_ends_m: Array
    inter: NDArray[np.bool_]

    @property
    def agents(self) -> list[str]:
        """Who is in it."""
        return sorted({track.agent for track in self.tracks})

    @property
    def num_keyframes(self) -> int:
        """Size of the map."""
        return sum(len(track.keyframes) for track in self.tracks)


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """All maps, largest first, and the (K, 2) outlines of the world's plan."""

    maps: Sequence[MapSubject]
    plan: Sequence[Array]

    @property
    def aligned(self) -> bool:
        """Whether everything is in the world frame."""
        return all(found.aligned for found in self.maps)

    @property
    def tracks(self) -> list[Track]:
        """The tracks of all maps."""
        return [track for found in self.maps for track in found.tracks]

    @property
    def agents(self) -> list[str]:
        """Everyone, in the order of their colours."""
        return sorted({track.agent for track in self.tracks})


def subject_of(record: RunRecord) -> Subject:
    """Lay a run out for drawing."""
    true_poses = record.true_poses()
    maps = [
        _map_subject(snapshot, record.groundtruth, true_poses, record.cauchy_scale)
        for snapshot in record.snapshots
        if snapshot.keyframes
    ]
    maps.sort(key=lambda found: -found.num_keyframes)
    aligned = bool(maps) and all(found.aligned for found in maps)
    return Subject(maps, tuple(record.plan) if aligned else ())


def _map_subject(
    snapshot: MapSnapshot,
    groundtruth: Mapping[str, Trajectory],
    true_poses: Mapping[KeyframeId, Array],
    cauchy_scale: float,
) -> MapSubject:
    pairs = [
        evaluation.associate(path, groundtruth[agent])
        for agent, path in export.trajectories([snapshot]).items()
        if agent in groundtruth
    ]
    aligned = any(len(pair) for pair in pairs)
    T_ref_body = (evaluation.alignment(pairs) if aligned else np.eye(4)) @ snapshot.T_map_body
    tracks = []
    for segment in sorted(snapshot.summary.segments):
        truth = groundtruth.get(segment.agent) if aligned else None
        tracks.append(_track(snapshot, segment, T_ref_body, truth, true_poses))
    loops = loop_edges(snapshot, true_poses, cauchy_scale)
    ends = np.stack([loops.cand, loops.query], axis=-1)
    agents = np.array([keyframe.agent for keyframe in snapshot.keyframes])
    return MapSubject(
        [track for track in tracks if len(track.keyframes)],
        aligned,
        loops,
        T_ref_body[ends][..., :3, 3],
        np.asarray(agents[loops.cand] != agents[loops.query]),
    )


def _track(
    snapshot: MapSnapshot,
    segment: SegmentId,
    T_ref_body: Array,
    truth: Trajectory | None,
    true_poses: Mapping[KeyframeId, Array],
) -> Track:
    found = [i for i, keyframe in enumerate(snapshot.keyframes) if keyframe.segment == segment]
    index = np.array(sorted(found, key=lambda i: snapshot.keyframes[i].seq), dtype=np.int64)
    stamps = snapshot.stamps_ns[index]
    true_m = np.full((len(index), 3), np.nan)
    if truth is not None:
        for row, i in enumerate(index):
            if (T := true_poses.get(snapshot.keyframes[i])) is not None:
                true_m[row] = T[:3, 3]
    first = int(np.argmax(np.isfinite(true_m[:, 0]))) if len(index) else 0
    before = np.zeros((0, 3))
    if len(index):
        T_start = true_poses.get(snapshot.keyframes[index[first]]) if truth is not None else None
        before = _laid(snapshot.T_odom_body[index], T_ref_body[index], first, T_start)
    return Track(
        segment.agent,
        index,
        stamps,
        before,
        T_ref_body[index, :3, 3],
        true_m,
        _between(truth, stamps),
    )


def _laid(T_odom_body: Array, T_ref_body: Array, first: int, T_start: Array | None) -> Array:
    """Positions (N, 3) of an odometry that starts at a true pose, or at the origin."""
    if T_start is None:
        T_start = frames.transform(T_ref_body[first, :3, :3], np.zeros(3))
    laid = T_start @ frames.inverse(T_odom_body[first]) @ T_odom_body
    return np.asarray(laid[:, :3, 3])


def _between(truth: Trajectory | None, stamps_ns: NDArray[np.int64]) -> Array:
    if truth is None or not len(stamps_ns):
        return np.zeros((0, 3))
    inside = (truth.stamps_ns >= stamps_ns[0]) & (truth.stamps_ns <= stamps_ns[-1])
    return np.asarray(truth.T_ref_body[inside, :3, 3])
