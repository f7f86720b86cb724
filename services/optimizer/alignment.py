"""Where the segments of a map start: a rigid placement of each from the loops alone.

Optimisation is local, so it needs a start in the right basin. The start must not depend on the
order in which loops were found (decision 0003), and one wrong loop must not spoil it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz.frames import Array, adjoint, inverse
from covinz.types import LoopClosure, SegmentId
from services.optimizer.components import Component
from services.optimizer.odometry_noise import step_covariances
from services.optimizer.pose_graph import NoiseOf
from services.optimizer.segments import Segment

# So many loops, evenly spaced by job id, are tried as a placement; all loops vote on each.
MAX_HYPOTHESES = 64
# Expected chi^2 of two placements that agree: the degrees of freedom of a pose.
DEGREES_OF_FREEDOM = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """A segment with its odometry's drift since its first row, to be differenced.

    Attributes:
        segment: The segment.
        rotation_var: (N,) accumulated variance per axis [rad^2].
        translation_var: (N,) accumulated variance per axis [m^2].
    """

    segment: Segment
    rotation_var: Array
    translation_var: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Attached:
    """A placed segment and the row by which it was placed: its drift counts from there."""

    T_map_odom: Array
    row: int


@dataclass(frozen=True, slots=True, eq=False)
class _Bridge:
    """A loop from a placed segment (a) to one that waits (b)."""

    job_id: str
    a: SegmentId
    row_a: int
    row_b: int
    T_a_b: Array
    rotation_var: float
    translation_var: float


@dataclass(frozen=True, slots=True, eq=False)
class _Placement:
    """The best placement of a waiting segment; `support` counts the loops that agree with it."""

    segment: SegmentId
    attached: _Attached
    support: float


def align_segments(component: Component, noise: NoiseOf) -> dict[SegmentId, Array]:
    """T_map_odom (4, 4) of every segment, as a start for optimisation.

    The map is the odom frame of the oldest segment. Then, as in Prim's algorithm, the segment
    whose placement has most support among the loops to the placed ones is placed next (ties: the
    older one). Of the placements that its loops propose, the one that the others agree with most
    is taken (a medoid under a redescending weight; ties: the lower job id), so that wrong loops
    are outvoted as long as more true ones agree with one another.

    Raises:
        ValueError: If the loops do not connect the segments.

    Source: decision 0003.
    """
    tracks = {segment.id: _track(segment, noise) for segment in component.segments}
    oldest, *rest = component.segments
    attached = {oldest.id: _Attached(np.eye(4), int(np.argmin(oldest.log_index)))}
    waiting = [segment.id for segment in rest]
    between = _loops_between(component.loops)
    found: dict[SegmentId, _Placement] = {}
    newest = oldest.id
    while waiting:
        for segment in waiting:
            if (newest, segment) in between:
                bridges = _bridges(segment, attached, between, tracks)
                found[segment] = _best_placement(segment, bridges, attached, tracks)
        if not found:
            raise ValueError(f"no loops to {', '.join(map(str, waiting))}")
        newest = max(
            (segment for segment in waiting if segment in found),
            key=lambda segment: found[segment].support,
        )
        attached[newest] = found.pop(newest).attached
        waiting.remove(newest)
    return {segment: place.T_map_odom for segment, place in attached.items()}


def _track(segment: Segment, noise: NoiseOf) -> _Track:
    steps = step_covariances(segment, noise(segment.id.agent))
    per_axis = np.einsum("nii->ni", steps)
    zero = np.zeros(1)
    return _Track(
        segment,
        np.concatenate([zero, np.cumsum(per_axis[:, :3].mean(axis=1))]),
        np.concatenate([zero, np.cumsum(per_axis[:, 3:].mean(axis=1))]),
    )


def _loops_between(
    loops: Sequence[LoopClosure],
) -> dict[tuple[SegmentId, SegmentId], list[LoopClosure]]:
    """Loops that span two segments, under both orders of the two."""
    between: dict[tuple[SegmentId, SegmentId], list[LoopClosure]] = {}
    for loop in loops:
        query, cand = loop.query.segment, loop.cand.segment
        if query != cand:
            between.setdefault((query, cand), []).append(loop)
            between.setdefault((cand, query), []).append(loop)
    return between


def _bridges(
    segment: SegmentId,
    attached: dict[SegmentId, _Attached],
    between: dict[tuple[SegmentId, SegmentId], list[LoopClosure]],
    tracks: dict[SegmentId, _Track],
) -> list[_Bridge]:
    """All loops between placed segments and `segment`, by job id."""
    bridges = []
    for a in attached:
        for loop in between.get((a, segment), ()):
            forward = loop.query.segment == segment
            body_a, body_b = (loop.cand, loop.query) if forward else (loop.query, loop.cand)
            variance = np.diag(loop.covariance if forward else _swapped(loop))
            bridges.append(
                _Bridge(
                    job_id=loop.job_id,
                    a=a,
                    row_a=tracks[a].segment.row(body_a),
                    row_b=tracks[segment].segment.row(body_b),
                    T_a_b=loop.T_cand_query if forward else inverse(loop.T_cand_query),
                    rotation_var=float(variance[:3].mean()),
                    translation_var=float(variance[3:].mean()),
                )
            )
    return sorted(bridges, key=lambda bridge: bridge.job_id)


def _swapped(loop: LoopClosure) -> Array:
    """(6, 6) covariance of T_query_cand, in the candidate body frame."""
    A = adjoint(loop.T_cand_query)
    return A @ loop.covariance @ A.T


def _best_placement(
    segment: SegmentId,
    bridges: list[_Bridge],
    attached: dict[SegmentId, _Attached],
    tracks: dict[SegmentId, _Track],
) -> _Placement:
    T_odom_b = tracks[segment].segment.T_odom_body[[bridge.row_b for bridge in bridges]]
    T_map_a = np.array(
        [
            attached[bridge.a].T_map_odom @ tracks[bridge.a].segment.T_odom_body[bridge.row_a]
            for bridge in bridges
        ]
    )
    T_map_odom = T_map_a @ np.array([b.T_a_b for b in bridges]) @ inverse(T_odom_b)
    count = min(len(bridges), MAX_HYPOTHESES)
    tried = np.unique(np.linspace(0, len(bridges) - 1, count).round().astype(np.int64))
    drift_a = _drift_between(tried, bridges, attached, tracks)
    track = tracks[segment]
    rows = np.array([bridge.row_b for bridge in bridges])
    drift_rotation = drift_a[0] + _difference(track.rotation_var[rows], tried)
    drift_translation = drift_a[1] + _difference(track.translation_var[rows], tried)
    support = _agreement(
        T_map_odom, tried, T_odom_b[:, :3, 3], bridges, drift_rotation, drift_translation
    ).sum(axis=1)
    best = int(tried[np.argmax(support)])
    place = _Attached(T_map_odom[best], bridges[best].row_b)
    return _Placement(segment, place, float(support.max()))


def _drift_between(
    tried: NDArray[np.int64],
    bridges: list[_Bridge],
    attached: dict[SegmentId, _Attached],
    tracks: dict[SegmentId, _Track],
) -> tuple[Array, Array]:
    """(H, L) odometry variance per axis between the placed ends of two loops.

    Rotation, then translation.

    On one segment that of the path between them; on two, that of the paths from each to the loop by
    which its segment was placed (segments placed in between are left out: this only widens a gate).
    """
    owner = np.array([list(attached).index(bridge.a) for bridge in bridges])
    same = owner[tried][:, None] == owner[None, :]
    result = []
    for name in ("rotation_var", "translation_var"):
        var = np.array([getattr(tracks[b.a], name)[b.row_a] for b in bridges])
        origin = np.array([getattr(tracks[b.a], name)[attached[b.a].row] for b in bridges])
        since = np.abs(var - origin)
        result.append(
            np.where(same, _difference(var, tried), since[tried][:, None] + since[None, :])
        )
    return result[0], result[1]


def _agreement(
    T_map_odom: Array,
    tried: NDArray[np.int64],
    p_odom_b: Array,
    bridges: list[_Bridge],
    drift_rotation: Array,
    drift_translation: Array,
) -> Array:
    """(H, L) weight in (0, 1] of loop j under the placement that loop i proposes.

    The two placements put body b_j at poses that differ by a rotation and a translation; their
    variances are those of both loops, of the odometry between them, and of the rotation's lever.
    """
    R, p = T_map_odom[:, :3, :3], T_map_odom[:, :3, 3]
    trace = R[tried].reshape(-1, 9) @ R.reshape(-1, 9).T
    angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
    moved = np.einsum("hij,lj->hli", R[tried], p_odom_b) + p[tried][:, None]
    stayed = np.einsum("lij,lj->li", R, p_odom_b) + p
    distance = np.linalg.norm(moved - stayed, axis=2)
    lever = np.linalg.norm(p_odom_b[tried][:, None] - p_odom_b[None, :], axis=2)
    rotation = np.array([bridge.rotation_var for bridge in bridges])
    translation = np.array([bridge.translation_var for bridge in bridges])
    turn = rotation[tried][:, None] + drift_rotation
    rotation_var = turn + rotation
    translation_var = (
        translation[tried][:, None] + translation + drift_translation + turn * lever**2
    )
    chi2 = angle**2 / rotation_var + distance**2 / translation_var
    weight: Array = 1.0 / (1.0 + chi2 / DEGREES_OF_FREEDOM)
    return weight


def _difference(values: Array, tried: NDArray[np.int64]) -> Array:
    return np.abs(values[tried][:, None] - values[None, :])
