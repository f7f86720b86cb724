"""Generated loop problems with ground truth: two rigs of cameras whose descriptors really match.

Made after the synthetic problems on which the solver was researched: 752 x 480 px, f = 458 px;
two query and three candidate keyframes; 1,000 features an image, of which all six camera pairs
together give 900 to 1,600 mutual matches with a stated share of wrong ones. A keypoint has one
error, shared by all pairs that it takes part in. Half of the wrong matches are repeated structure
(two places that look alike, each seen consistently by its rig), half are of single images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import covinz_core as core
import numpy as np
from numpy.typing import NDArray

from benchmarks.loop_conditions import Condition
from covinz import frames

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

FOCAL_PX = 458.0
IMAGE_SIZE_PX = (752, 480)
FEATURES = 1000
DESCRIPTOR_BYTES = 32
# The body's x axis looks ahead, z up; the camera sits beside it as on a drone.
T_BODY_CAM = frames.transform(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [0.05, 0.03, -0.02]
)
# A keyframe finds a landmark in its view again with this probability.
_REPEATABILITY = 0.7
# Flipped bits of one observation; two of the same landmark differ by 10 to 54 of 256 bits.
_BIT_FLIPS = (0.02, 0.12)
_PROPOSALS = 20_000
# Size of a spot of landmarks, and waves that make up a shared error.
_SPOT_PX = 40.0
_WAVES = 64
# How much worse than told a motion of the odometry's tail is.
_TAIL = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The features of one image.

    Attributes:
        bearings: (1000, 3) unit vectors in the camera frame.
        descriptors: (1000, 32) like ORB's.
        landmarks: (1000,) the landmark of each feature, -1 for none; a match is right where both
            sides have the same one.
    """

    bearings: Array
    descriptors: NDArray[np.uint8]
    landmarks: Ids


@dataclass(frozen=True, slots=True, eq=False)
class LoopProblem:
    """One problem as the solver sees it, and the truth.

    Attributes:
        query: Cameras of the query rig (reference, previous), posed by odometry.
        cand: Cameras of the candidate rig (reference, previous, next).
        T_cand_query: (4, 4) true pose of the query body in the candidate's.
        T_query_cam: (2, 4, 4) true camera poses in the query body frame.
        T_cand_cam: (3, 4, 4) likewise in the candidate's.
        T_query_cam_odometry: (2, 4, 4) the same as odometry has them: what the solvers are told.
        T_cand_cam_odometry: (3, 4, 4) likewise.
        query_views: What the query cameras see.
        cand_views: What the candidate cameras see.
    """

    query: Sequence[core.RigCamera]
    cand: Sequence[core.RigCamera]
    T_cand_query: Array
    T_query_cam: Array
    T_cand_cam: Array
    T_query_cam_odometry: Array
    T_cand_cam_odometry: Array
    query_views: Sequence[View]
    cand_views: Sequence[View]


def generate(condition: Condition, seed: int) -> LoopProblem:
    """A problem of this kind; the same seed gives the same arrays."""
    rng = np.random.default_rng(seed)
    T_cand_query = _loop(condition, rng)
    query_steps = _steps(condition, 1, rng)
    cand_steps = _steps(condition, 2, rng)
    T_query_cam = _cameras([frames.inverse(query_steps[0])])
    T_cand_cam = _cameras([frames.inverse(cand_steps[0]), cand_steps[1]])
    images = _Images(condition, np.concatenate([T_cand_query @ T_query_cam, T_cand_cam]), rng)
    images.fill()

    drifted = [T @ _noise(condition, rng) for T in (*query_steps, *cand_steps)]
    odometry = np.concatenate(
        [
            _cameras([frames.inverse(drifted[0])]),
            _cameras([frames.inverse(drifted[1]), drifted[2]]),
        ]
    )
    views = [images.observe(i) for i in range(len(odometry))]
    cameras = [
        core.RigCamera(T, view.bearings, view.descriptors, FOCAL_PX)
        for T, view in zip(odometry, views, strict=True)
    ]
    return LoopProblem(
        cameras[:2],
        cameras[2:],
        T_cand_query,
        T_query_cam,
        T_cand_cam,
        odometry[:2],
        odometry[2:],
        views[:2],
        views[2:],
    )


def _cameras(T_ref_others: Sequence[Array]) -> Array:
    """Camera poses (K, 4, 4) in the body frame of the reference, which comes first."""
    return np.stack([np.eye(4), *T_ref_others]) @ T_BODY_CAM


def _loop(condition: Condition, rng: np.random.Generator) -> Array:
    direction = rng.normal(size=3)
    if condition.forward:
        direction = _ahead(rng) * rng.choice([-1.0, 1.0])
    turn = rng.normal(scale=np.deg2rad(3) / np.sqrt(3), size=3)
    turn[2] = rng.uniform(-condition.loop_yaw_rad, condition.loop_yaw_rad)
    distance = rng.uniform(*condition.loop_m)
    return frames.transform(frames.so3_exp(turn), distance * direction / np.linalg.norm(direction))


def _steps(condition: Condition, count: int, rng: np.random.Generator) -> list[Array]:
    """True T_prev_cur of neighbouring keyframes: mostly level, in one direction."""
    angle = rng.uniform(-np.pi, np.pi)
    steps = []
    for _ in range(count):
        bearing = angle + rng.normal(scale=0.3)
        direction = np.array([np.cos(bearing), np.sin(bearing), rng.normal(scale=0.2)])
        if condition.forward:
            direction = _ahead(rng)
        distance = rng.uniform(*condition.step_m)
        turn = rng.normal(scale=condition.step_turn_rad / np.sqrt(3), size=3)
        steps.append(
            frames.transform(frames.so3_exp(turn), distance * direction / np.linalg.norm(direction))
        )
    return steps


def _ahead(rng: np.random.Generator) -> Array:
    """Straight on as robots drive: exactly straight, no two views would tell the scale."""
    return np.array([1.0, rng.normal(scale=0.15), rng.normal(scale=0.1)])


def _noise(condition: Condition, rng: np.random.Generator) -> Array:
    times = _TAIL if condition.tail_share > 0 and rng.random() < condition.tail_share else 1.0
    return frames.transform(
        frames.so3_exp(rng.normal(scale=times * condition.odometry_sigma_rad, size=3)),
        rng.normal(scale=times * condition.odometry_sigma_m, size=3),
    )


class _Images:
    """What the five cameras see: things with one descriptor each, right to match or not."""

    def __init__(self, condition: Condition, T_world_cam: Array, rng: np.random.Generator) -> None:
        self._condition = condition
        self._T_world_cam = T_world_cam  # the query's two first
        self._rng = rng
        # Rows are things, columns cameras; NaN where a camera does not see the thing.
        self._pixels = np.empty((0, 5, 2))
        self._descriptors = np.empty((0, DESCRIPTOR_BYTES), np.uint8)
        self._num_landmarks = 0

    def fill(self) -> None:
        """Landmarks and look-alikes until the matches are as many as wanted."""
        matches = self._rng.uniform(*self._condition.matches)
        wrong = self._condition.outlier_share * matches
        landmarks = self._take(self._views(self._points(2)), matches - wrong)
        self._num_landmarks = len(landmarks)
        alike = self._alike()
        self._pixels = np.concatenate(
            [landmarks, self._take(alike, wrong / 2), self._single(round(wrong / 2))]
        )
        self._descriptors = self._random_descriptors(len(self._pixels))

    def observe(self, camera: int) -> View:
        """The 1,000 features of one image: what it sees of all things, the rest clutter."""
        (seen,) = np.nonzero(np.isfinite(self._pixels[:, camera, 0]))
        seen = seen[:FEATURES]
        rest = FEATURES - len(seen)
        pixels = np.concatenate(
            [self._pixels[seen, camera], self._rng.uniform((0, 0), IMAGE_SIZE_PX, (rest, 2))]
        )
        pixels[: len(seen)] += self._rng.normal(scale=self._condition.noise_px, size=(len(seen), 2))
        if self._condition.shared_px > 0:
            pixels += self._shared_error(pixels)
        descriptors = np.concatenate(
            [self._flip(self._descriptors[seen]), self._random_descriptors(rest)]
        )
        landmarks = np.full(FEATURES, -1)
        landmarks[: len(seen)] = np.where(seen < self._num_landmarks, seen, -1)
        order = self._rng.permutation(FEATURES)
        return View(_bearings(pixels[order]), descriptors[order], landmarks[order])

    def _alike(self) -> Array:
        """Views (N, 5, 2) of things that each rig sees consistently, but not the same."""
        pitch_m = self._condition.pitch_m
        points = self._points(0)
        alike = self._views(points)
        if pitch_m is None:
            alike[:, 2:] = self._views(self._points(2))[:, 2:]
        else:
            along = self._T_world_cam[2][:3, 0]
            alike[:, 2:] = self._views(points + pitch_m * along)[:, 2:]
        return alike

    def _points(self, camera: int) -> Array:
        """Points (N, 3) in the world, spread over the view of one camera."""
        condition = self._condition
        pixels = self._rng.uniform((0, 0), IMAGE_SIZE_PX, (_PROPOSALS, 2))
        if condition.clusters:
            spots = self._rng.uniform((0, 0), IMAGE_SIZE_PX, (condition.clusters, 2))
            pixels = self._rng.permutation(spots.repeat(_PROPOSALS // condition.clusters + 1, 0))
            pixels = pixels[:_PROPOSALS] + self._rng.normal(scale=_SPOT_PX, size=(_PROPOSALS, 2))
        rays = np.column_stack([(pixels - _centre()) / FOCAL_PX, np.ones(_PROPOSALS)])
        depths = self._rng.uniform(*condition.depth_m, _PROPOSALS)
        if condition.wall_relief_m is not None:
            depths = self._wall(rays) + self._rng.normal(
                scale=condition.wall_relief_m, size=_PROPOSALS
            )
        points_cam = rays * depths[:, None]
        T = self._T_world_cam[camera]
        points_world: Array = points_cam @ T[:3, :3].T + T[:3, 3]
        return points_world

    def _wall(self, rays: Array) -> Array:
        """Depths (N,) along rays of a wall that is turned by up to 30 degrees."""
        distance_m = self._rng.uniform(*self._condition.depth_m)
        slope = self._rng.uniform(-0.5, 0.5, 2)
        depths: Array = distance_m / np.maximum(1 + rays[:, :2] @ slope, 0.2)
        return depths

    def _shared_error(self, pixels: Array) -> Array:
        """Errors (N, 2) of a smooth random field, by random Fourier features."""
        waves = self._rng.normal(scale=1 / self._condition.shared_length_px, size=(_WAVES, 2))
        phases = self._rng.uniform(0, 2 * np.pi, (2, _WAVES))
        field = np.cos(pixels @ waves.T + phases[:, None]).sum(-1).T
        error: Array = self._condition.shared_px * np.sqrt(2 / _WAVES) * field
        return error

    def _views(self, points_world: Array) -> Array:
        """Pixels (N, 5, 2) without noise, NaN where a camera does not find the point."""
        T_cam_world = frames.inverse(self._T_world_cam)
        points_cam = np.einsum("cij,nj->nci", T_cam_world[:, :3, :3], points_world)
        points_cam += T_cam_world[:, :3, 3]
        depth = points_cam[..., 2:]
        pixels = FOCAL_PX * points_cam[..., :2] / np.where(depth > 0.1, depth, np.nan) + _centre()
        inside = ((pixels >= 0) & (pixels <= IMAGE_SIZE_PX)).all(-1)
        found = inside & (self._rng.random(inside.shape) < _REPEATABILITY)
        return np.where(found[..., None], pixels, np.nan)

    def _take(self, views: Array, matches: float) -> Array:
        """As many things, in order, as make this many matches."""
        seen = np.isfinite(views[..., 0])
        made = seen[:, :2].sum(1) * seen[:, 2:].sum(1)
        views, made = views[made > 0], made[made > 0]
        return views[: int(np.searchsorted(np.cumsum(made), matches))]

    def _single(self, matches: int) -> Array:
        """Things that one query and one candidate camera see where they like."""
        pixels = np.full((matches, 5, 2), np.nan)
        for first, count in ((0, 2), (2, 3)):
            cameras = first + self._rng.integers(count, size=matches)
            at = self._rng.uniform((0, 0), IMAGE_SIZE_PX, (matches, 2))
            pixels[np.arange(matches), cameras] = at
        return pixels

    def _random_descriptors(self, count: int) -> NDArray[np.uint8]:
        return self._rng.integers(0, 256, (count, DESCRIPTOR_BYTES), dtype=np.uint8)

    def _flip(self, descriptors: NDArray[np.uint8]) -> NDArray[np.uint8]:
        share = self._rng.uniform(*_BIT_FLIPS, (len(descriptors), 1))
        flips = self._rng.random((len(descriptors), 8 * DESCRIPTOR_BYTES)) < share
        return descriptors ^ np.packbits(flips, axis=1)


def _centre() -> Array:
    return (np.array(IMAGE_SIZE_PX) - 1) / 2


def _bearings(pixels: Array) -> Array:
    rays = np.column_stack([(pixels - _centre()) / FOCAL_PX, np.ones(len(pixels))])
    bearings: Array = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return bearings
