"""Which keyframes around a reference make the best rig, by odometry and calibration alone.

What a rig is for is scale: odometry knows how far apart its cameras are, and nothing else does. Two
of its cameras, a baseline b apart, tell the scale with the information

    shared * b^2 / sigma^2

where sigma is odometry's error over the path between them, and shared is the part of the
reference's matches that both of them can have. Information adds up along a rig in order of time,
since odometry's errors of consecutive stretches are independent: two cameras beside each other
count little more than one. Distant cameras have long baselines, but less of the view in common, see
it from other sides, and odometry's rotation has drifted by more than the search for hypotheses,
which holds rigs rigid, forgives: all three are in `shared`.

Source: decision 0021.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import covinz_core
import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.config import MAX_RIG_SIZE, FastLoopConfig, OdometryNoise, RigConfig
from covinz.types import Array, Camera

# Rays of the reference camera that stand for its view.
_GRID = (8, 6)
# What differs by less than this is equal, and then the nearer keyframe is taken: rounding, which
# changes with the odometry's frame, decides nothing.
_QUANTUM = 1e-6


@dataclass(frozen=True, slots=True)
class Choice:
    """A rig.

    Attributes:
        rows: The reference first, then the others in order of time.
        information: What it tells about scale: one over the relative variance.
    """

    rows: tuple[int, ...]
    information: float


def window(T_odom_body: Array, reference: int, rigs: RigConfig) -> slice:
    """The rows of a session (N, 4, 4) around one that are looked at for its rig.

    As far as `max_path_m` of path, at most `max_steps` keyframes on either side, and the few next
    to it however far they are.
    """
    first = max(0, reference - rigs.max_steps)
    metres = _along(T_odom_body[first : reference + rigs.max_steps + 1]).metres
    steps = np.abs(np.arange(len(metres)) - (reference - first))
    far_m = np.abs(metres - metres[reference - first])
    rows = first + np.flatnonzero((far_m <= rigs.max_path_m) | (steps < MAX_RIG_SIZE))
    return slice(int(rows[0]), int(rows[-1]) + 1)


def choose(
    T_odom_body: Array,
    cameras: Sequence[Camera],
    reference: int,
    size: int,
    rigs: RigConfig,
    fast: FastLoopConfig,
) -> Choice:
    """The best rig around a keyframe.

    Where too few keyframes have enough of the reference's view, the places left go to those that
    can be matched best with it, of equal ones to the nearest. Only motions between the keyframes
    count, not the odometry's frame.

    Args:
        T_odom_body: (N, 4, 4) odometry poses of keyframes of one session in order of time.
        cameras: Their N calibrations.
        reference: Row of the keyframe that the rig is for.
        size: Keyframes in the rig; all N where there are fewer.
        rigs: What a rig should be like.
        fast: Odometry's accuracy, and the inlier threshold of the hypotheses.

    Raises:
        ValueError: If a calibration is not what the core accepts.
    """
    T_odom_cam = T_odom_body @ np.stack([camera.T_body_cam for camera in cameras])
    along = _along(T_odom_body)
    focal_px = float(np.mean(cameras[reference].params[:2]))
    common = _common(T_odom_cam, cameras, reference, rigs)
    shared = common.matched * _held(along, reference, focal_px, fast)
    worth = _quantised(_information(T_odom_cam[:, :3, 3], along, shared, fast.odometry))
    allowed = (common.seen >= rigs.min_overlap) | (np.arange(len(shared)) == reference)
    num_others = min(size, len(shared)) - 1
    chosen = _best_chain(worth, allowed, reference, num_others)
    rest = {*range(len(shared))} - {reference, *chosen}
    rank = _quantised(common.matched)
    fill = sorted(rest, key=lambda row: (-rank[row], abs(row - reference), row))
    others = sorted([*chosen, *fill[: num_others - len(chosen)]])
    links = pairwise(sorted([reference, *others]))
    return Choice((reference, *others), _QUANTUM * sum(int(worth[link]) for link in links))


@dataclass(frozen=True, slots=True, eq=False)
class _Along:
    """(N,) metres travelled and radians turned from the first keyframe on."""

    metres: Array
    radians: Array


def _along(T_odom_body: Array) -> _Along:
    T_prev_cur = frames.inverse(T_odom_body[:-1]) @ T_odom_body[1:]
    metres = np.linalg.norm(T_prev_cur[:, :3, 3], axis=1)
    radians = frames.rotation_angle(T_prev_cur)
    return _Along(*(np.concatenate([[0.0], np.cumsum(each)]) for each in (metres, radians)))


@dataclass(frozen=True, slots=True, eq=False)
class _Common:
    """(N,) part of the reference's view that each camera has, and that it can be matched in."""

    seen: Array
    matched: Array


def _common(
    T_odom_cam: Array, cameras: Sequence[Camera], reference: int, rigs: RigConfig
) -> _Common:
    """What the cameras have in common with the reference if the scene is at `depth_m`."""
    views = [_view(camera) for camera in cameras]
    rays = views[reference].rays
    T_ref_cam = frames.inverse(T_odom_cam[reference]) @ T_odom_cam
    rays_ref = rigs.depth_m * rays - T_ref_cam[:, None, :3, 3]
    rays_cam = rays_ref @ T_ref_cam[:, :3, :3]
    angles = np.arctan2(rays_cam[..., :2], rays_cam[..., 2:])
    limits = np.stack([view.limits for view in views])[:, None]
    seen = ((angles >= limits[..., 0, :]) & (angles <= limits[..., 1, :])).all(axis=-1)
    distance_m = np.maximum(np.linalg.norm(rays_ref, axis=-1), 1e-9)
    cosine = (rays_ref * rays).sum(axis=-1) / distance_m
    turned_rad = np.arccos(np.clip(cosine, -1.0, 1.0))
    change = np.hypot(turned_rad, np.log(distance_m / rigs.depth_m))
    matched = seen * 0.5 ** ((change / rigs.half_view_change) ** 2)
    return _Common(seen.mean(axis=-1), matched.mean(axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """What a calibration says of a view.

    Attributes:
        rays: (M, 3) unit vectors that stand for it.
        limits: (2, 2) angles [rad] from the optical axis: left and top, right and bottom.
    """

    rays: Array
    limits: Array


@functools.lru_cache(maxsize=64)
def _view(camera: Camera) -> _View:
    across, down = ((np.arange(n) + 0.5) / n for n in _GRID)
    at = np.stack(np.meshgrid(across * camera.width, down * camera.height), -1).reshape(-1, 2)
    x, y = camera.width / 2 - 0.5, camera.height / 2 - 0.5
    right, bottom = camera.width - 1.0, camera.height - 1.0
    border = _bearings(camera, np.array([[0.0, y], [x, 0.0], [right, y], [x, bottom]]))
    angles = np.arctan2(border[:, :2], border[:, 2:])
    limits = angles[[0, 1, 2, 3], [0, 1, 0, 1]].reshape(2, 2)
    return _View(_bearings(camera, at - 0.5), limits)


def _bearings(camera: Camera, at_px: Array) -> Array:
    bearings: Array = covinz_core.bearing_vectors(camera.model, camera.params.tolist(), at_px)
    return bearings


def _held(along: _Along, reference: int, focal_px: float, fast: FastLoopConfig) -> Array:
    """(N,) part of the matches that stay inliers while odometry's rotation is taken as exact."""
    metres = np.abs(along.metres - along.metres[reference])
    radians = np.abs(along.radians - along.radians[reference])
    noise = fast.odometry
    variance = noise.rotation_per_sqrt_m**2 * metres + noise.rotation_per_sqrt_rad**2 * radians
    sigma_px = focal_px * np.sqrt(variance + noise.min_rotation**2)
    held = np.array([math.erf(t) for t in fast.max_error_px / (np.sqrt(2.0) * sigma_px)])
    held[reference] = 1.0
    return held


def _information(centres_m: Array, along: _Along, shared: Array, noise: OdometryNoise) -> Array:
    """(N, N) what each pair of cameras tells about scale: one over its relative variance."""
    squared = np.sum((centres_m[:, None] - centres_m[None]) ** 2, axis=-1)
    metres = np.abs(along.metres[:, None] - along.metres[None])
    radians = np.abs(along.radians[:, None] - along.radians[None])
    variance = (
        noise.translation_per_sqrt_m**2 * metres
        + noise.translation_per_sqrt_rad**2 * radians
        + noise.min_translation**2
    )
    information: Array = np.minimum(shared[:, None], shared[None]) * squared / variance
    return information


def _quantised(values: Array) -> NDArray[np.int64]:
    return np.rint(values / _QUANTUM).astype(np.int64)


def _best_chain(
    worth: NDArray[np.int64], allowed: NDArray[np.bool_], reference: int, num_others: int
) -> list[int]:
    """Up to `num_others` allowed rows whose chain through the reference is worth most.

    A chain's worth is that of its links, from each row to the next in order of time. Of equal
    chains the one that is as long on both sides, and the nearest, is taken.
    """
    before = np.flatnonzero(allowed[: reference + 1])[::-1]
    after = reference + np.flatnonzero(allowed[reference:])
    one, other = _sides(worth, before, num_others), _sides(worth, after, num_others)
    count = min(num_others, len(one) + len(other) - 2)
    best: list[int] = []
    most = -1
    splits = range(max(0, count - len(other) + 1), min(count, len(one) - 1) + 1)
    for num in sorted(splits, key=lambda num: (abs(2 * num - count), -num)):
        total = one[num][0] + other[count - num][0]
        if total > most:
            most, best = total, [*one[num][1], *other[count - num][1]]
    return best


def _sides(
    worth: NDArray[np.int64], rows: NDArray[np.intp], num_others: int
) -> list[tuple[int, list[int]]]:
    """For 0, 1, .. rows of one side of the reference: their most worth and which they are.

    Args:
        worth: (N, N) of links.
        rows: The reference and the rows of that side, the nearest first.
        num_others: No more rows than that.
    """
    links = worth[rows[:, None], rows]
    each = np.arange(len(rows))
    possible = each[:, None] < each
    value = np.where(each == 0, 0, -1)
    came: list[NDArray[np.intp]] = []
    found = [(0, list[int]())]
    for _ in range(min(num_others, len(rows) - 1)):
        total = np.where(possible & (value[:, None] >= 0), value[:, None] + links, -1)
        came.append(total.argmax(axis=0))
        value = total[came[-1], each]
        at = int(value.argmax())
        most, chain = int(value[at]), list[int]()
        for before in reversed(came):
            chain.insert(0, int(rows[at]))
            at = int(before[at])
        found.append((most, chain))
    return found
