"""Where the segments of a map start: a rigid placement of each from the loops alone.

Optimisation is local, so it needs a start in the right basin. The start must not depend on the
order in which loops were found (decision 0003), and one wrong loop must not spoil it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz.frames import Array, adjoint, inverse
from covinz.types import SegmentId
from services.optimizer.components import Component, rows_of
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
class _Bridges:
    """Loops from one segment (a) to another (b), one a row; segments by number, by age.

    Attributes:
        a: (L,) int64 segment.
        b: (L,) int64 segment.
        row_a: (L,) int64.
        row_b: (L,) int64.
        T_a_b: (L, 4, 4) between the two bodies.
        rotation_var: (L,) of T_a_b per axis [rad^2].
        translation_var: (L,) of T_a_b per axis [m^2].
    """

    a: NDArray[np.int64]
    b: NDArray[np.int64]
    row_a: NDArray[np.int64]
    row_b: NDArray[np.int64]
    T_a_b: Array
    rotation_var: Array
    translation_var: Array

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> _Bridges:
        """Some of the rows, by mask or in another order."""
        return _Bridges(*(getattr(self, name)[chosen] for name in _Bridges.__slots__))


@dataclass(frozen=True, slots=True, eq=False)
class _Placement:
    """The best placement of a waiting segment; `support` counts the loops that agree with it."""

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
    tracks = [_track(segment, noise) for segment in component.segments]
    bridges = _both_ways(component)
    attached = {0: _Attached(np.eye(4), int(np.argmin(component.segments[0].log_index)))}
    waiting = list(range(1, len(tracks)))
    found: dict[int, _Placement] = {}
    newest = 0
    while waiting:
        to_newest = set(bridges.b[bridges.a == newest].tolist())
        for b in waiting:
            if b in to_newest:
                to_placed = bridges.of((bridges.b == b) & np.isin(bridges.a, list(attached)))
                found[b] = _best_placement(to_placed, attached, tracks)
        if not found:
            names = (str(component.segments[b].id) for b in waiting)
            raise ValueError(f"no loops to {', '.join(names)}")
        newest = max((b for b in waiting if b in found), key=lambda b: found[b].support)
        attached[newest] = found.pop(newest).attached
        waiting.remove(newest)
    return {component.segments[i].id: place.T_map_odom for i, place in attached.items()}


def _track(segment: Segment, noise: NoiseOf) -> _Track:
    steps = step_covariances(segment, noise(segment.id.agent))
    per_axis = np.einsum("nii->ni", steps)
    zero = np.zeros(1)
    return _Track(
        segment,
        np.concatenate([zero, np.cumsum(per_axis[:, :3].mean(axis=1))]),
        np.concatenate([zero, np.cumsum(per_axis[:, 3:].mean(axis=1))]),
    )


def _both_ways(component: Component) -> _Bridges:
    """All loops that span two segments, by job id, each from its candidate and from its query."""
    loops = sorted(
        (loop for loop in component.loops if loop.query.segment != loop.cand.segment),
        key=lambda loop: loop.job_id,
    )
    T_cand_query = np.array([loop.T_cand_query for loop in loops]).reshape(-1, 4, 4)
    covariance = np.array([loop.covariance for loop in loops]).reshape(-1, 6, 6)
    cand, row_cand = rows_of(component, [loop.cand for loop in loops])
    query, row_query = rows_of(component, [loop.query for loop in loops])
    # The covariance of T_query_cand is in the candidate body frame.
    A = adjoint(T_cand_query)
    variance = np.concatenate([covariance, A @ covariance @ A.swapaxes(1, 2)])
    per_axis = np.einsum("nii->ni", variance)
    both = _Bridges(
        a=np.concatenate([cand, query]),
        b=np.concatenate([query, cand]),
        row_a=np.concatenate([row_cand, row_query]),
        row_b=np.concatenate([row_query, row_cand]),
        T_a_b=np.concatenate([T_cand_query, inverse(T_cand_query)]),
        rotation_var=per_axis[:, :3].mean(axis=1),
        translation_var=per_axis[:, 3:].mean(axis=1),
    )
    return both.of(np.arange(2 * len(loops)).reshape(2, -1).T.ravel())


def _best_placement(
    bridges: _Bridges, attached: dict[int, _Attached], tracks: list[_Track]
) -> _Placement:
    """Of the one segment that all bridges lead to."""
    track = tracks[bridges.b[0]]
    T_odom_b = track.segment.T_odom_body[bridges.row_b]
    T_map_a = np.empty_like(T_odom_b)
    for a, place in attached.items():
        of_a = bridges.a == a
        T_map_a[of_a] = place.T_map_odom @ tracks[a].segment.T_odom_body[bridges.row_a[of_a]]
    T_map_odom = T_map_a @ bridges.T_a_b @ inverse(T_odom_b)
    count = min(len(bridges.a), MAX_HYPOTHESES)
    tried = np.unique(np.linspace(0, len(bridges.a) - 1, count).round().astype(np.int64))
    drift_a = _drift_between(tried, bridges, attached, tracks)
    drift_rotation = drift_a[0] + _difference(track.rotation_var[bridges.row_b], tried)
    drift_translation = drift_a[1] + _difference(track.translation_var[bridges.row_b], tried)
    support = _agreement(
        T_map_odom, tried, T_odom_b[:, :3, 3], bridges, drift_rotation, drift_translation
    ).sum(axis=1)
    best = int(tried[np.argmax(support)])
    return _Placement(_Attached(T_map_odom[best], int(bridges.row_b[best])), float(support.max()))


def _drift_between(
    tried: NDArray[np.int64],
    bridges: _Bridges,
    attached: dict[int, _Attached],
    tracks: list[_Track],
) -> tuple[Array, Array]:
    """(H, L) odometry variance per axis between the placed ends of two loops.

    Rotation, then translation.

    On one segment that of the path between them; on two, that of the paths from each to the loop by
    which its segment was placed (segments placed in between are left out: this only widens a gate).
    """
    same = bridges.a[tried][:, None] == bridges.a[None, :]
    result = []
    for name in ("rotation_var", "translation_var"):
        var, origin = np.empty(len(bridges.a)), np.empty(len(bridges.a))
        for a, place in attached.items():
            of_a = bridges.a == a
            along = getattr(tracks[a], name)
            var[of_a], origin[of_a] = along[bridges.row_a[of_a]], along[place.row]
        since = np.abs(var - origin)
        result.append(
            np.where(same, _difference(var, tried), since[tried][:, None] + since[None, :])
        )
    return result[0], result[1]


def _agreement(
    T_map_odom: Array,
    tried: NDArray[np.int64],
    p_odom_b: Array,
    bridges: _Bridges,
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
    rotation, translation = bridges.rotation_var, bridges.translation_var
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
