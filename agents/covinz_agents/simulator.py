"""Plays robots that walk through a simulated hall; needs no data."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.scenario import SimulatedAgent, Walk, World
from covinz.trajectory import Trajectory
from covinz.types import Array, Camera, Features, FeatureType
from covinz_agents.drift import drifting_odometry, seed_of
from covinz_agents.landmarks import Hall, build_hall, detect, recognisable, unhidden
from covinz_agents.source import Frame

# The simulation starts at this time. [ns since the Unix epoch]
START_NS = 1_700_000_000_000_000_000

# Forward-looking (x of the body is z of the camera), a hand's breadth ahead of the body's origin.
T_BODY_CAM = frames.transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.1, 0.03, 0.05])
# A wide lens with visible distortion: 79 degrees across.
CAMERA = Camera(
    "OPENCV", 640, 480, np.array([390, 391, 318.4, 241.7, -0.1, 0.02, 5e-4, -3e-4]), T_BODY_CAM
)
# Beyond this ray angle the distortion model is of no use. [tangent]
_MAX_TANGENT = 1.3
# Body sway: roll and pitch [rad], height [m], and their periods [s].
_SWAY = ((0.03, 2.1), (0.04, 3.3), (0.05, 1.7))

build_hall_once = lru_cache(maxsize=2)(build_hall)


class SimulatedRobot:
    """A `Source`: one robot on its walk.

    The same scenario gives the same bits; a frame's features do not depend on which other frames
    were asked for.
    """

    def __init__(self, agent: SimulatedAgent, world: World) -> None:
        self._agent, self._world = agent, world
        self._hall: Hall = build_hall_once(world)
        self._groundtruth = walk(agent.walk, world.frame_rate_hz)
        T_odom_body = drifting_odometry(self._groundtruth.T_ref_body, agent.drift, agent.id)
        stamps_ns = self._groundtruth.stamps_ns
        self._frames = [
            Frame(number, int(stamp_ns), T)
            for number, (stamp_ns, T) in enumerate(zip(stamps_ns, T_odom_body, strict=True))
        ]

    @property
    def camera(self) -> Camera:
        """The camera that all simulated robots carry."""
        return CAMERA

    @property
    def frames(self) -> Sequence[Frame]:
        """All images of the walk."""
        return self._frames

    @property
    def skipped(self) -> int:
        """None: every image has a pose."""
        return 0

    @property
    def groundtruth(self) -> Trajectory:
        """Exact ``T_world_body`` of every image."""
        return self._groundtruth

    def features(self, frame: Frame) -> Features:
        """What the robot's camera finds at a frame, in random order."""
        rng = np.random.default_rng(
            seed_of("image", self._world.seed, self._agent.id, frame.number)
        )
        number = self._agent.features.num_features
        num_clutter = round(number * self._world.clutter)
        T_world_cam = self._groundtruth.T_ref_body[frame.number] @ T_BODY_CAM
        position_m = T_world_cam[:3, 3]
        indices, points_px = self._in_view(T_world_cam)
        found, descriptors = detect(self._hall, indices, position_m, number - num_clutter, rng)
        keypoints_px = points_px[np.searchsorted(indices, found)]
        keypoints_px = keypoints_px + self._world.noise_px * rng.normal(size=keypoints_px.shape)
        size = (CAMERA.width - 1, CAMERA.height - 1)
        keypoints_px = np.concatenate([keypoints_px, rng.uniform((0, 0), size, (num_clutter, 2))])
        clutter = rng.integers(256, size=(num_clutter, 32), dtype=np.uint8)
        order = rng.permutation(len(keypoints_px))
        return Features(
            FeatureType.ORB,
            np.clip(keypoints_px, 0, size).astype(np.float32)[order],
            np.concatenate([descriptors, clutter])[order],
        )

    def _in_view(self, T_world_cam: Array) -> tuple[NDArray[np.intp], Array]:
        """Landmarks that can be recognised in the image, ascending, and their true pixels."""
        position_m = T_world_cam[:3, 3]
        indices = recognisable(self._hall, position_m)
        points_px = project(self._hall.landmarks.positions_m[indices], T_world_cam)
        inside = in_image(points_px)
        indices, points_px = indices[inside], points_px[inside]
        seen = unhidden(self._hall, indices, position_m)
        return seen, points_px[np.isin(indices, seen, assume_unique=True)]


def walk(path: Walk, frame_rate_hz: float) -> Trajectory:
    """True poses ``T_world_body`` of a walk: body x ahead, z up, world z up, floor at 0."""
    radii = np.array(path.radii_m)
    # Equal steps along the ellipse: invert its arc length numerically.
    angles = np.linspace(0, 2 * np.pi * path.laps, 1 + round(2000 * max(1.0, abs(path.laps))))
    angles += path.start_rad
    curve = np.array(path.center_m) + radii * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    n = 1 + int(length[-1] / path.speed_m_s * frame_rate_hz)
    seconds = np.arange(n) / frame_rate_hz
    angle = np.interp(seconds * path.speed_m_s, length, angles)
    direction = np.sign(path.laps) * radii * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    yaw = np.arctan2(direction[:, 1], direction[:, 0]) + path.look_rad
    roll, pitch, heave = (size * np.sin(2 * np.pi * seconds / period) for size, period in _SWAY)
    zero = np.zeros(n)
    R = (
        frames.so3_exp(np.stack([zero, zero, yaw], axis=1))
        @ frames.so3_exp(np.stack([zero, pitch, zero], axis=1))
        @ frames.so3_exp(np.stack([roll, zero, zero], axis=1))
    )
    xy = np.array(path.center_m) + radii * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    p = np.concatenate([xy, (path.height_m + heave)[:, None]], axis=1)
    period_ns = round(1e9 / frame_rate_hz)
    stamps_ns = START_NS + round(path.start_s * 1e9) + period_ns * np.arange(n, dtype=np.int64)
    return Trajectory(stamps_ns, frames.transform(R, p))


def project(points_m: Array, T_world_cam: Array) -> Array:
    """Pixels (N, 2) of world points (N, 3); NaN behind the camera or beyond its field of view."""
    T_cam_world = frames.inverse(T_world_cam)
    points_cam = points_m @ T_cam_world[:3, :3].T + T_cam_world[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        rays = points_cam[:, :2] / points_cam[:, 2:]
    usable = (points_cam[:, 2] > 0) & (np.abs(rays).max(axis=1, initial=0) < _MAX_TANGENT)
    pixels = np.full((len(points_m), 2), np.nan)
    if usable.any():
        fx, fy, cx, cy = CAMERA.params[:4]
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        projected, _ = cv2.projectPoints(
            points_cam[usable], np.zeros(3), np.zeros(3), K, CAMERA.params[4:]
        )
        pixels[usable] = projected[:, 0]
    return pixels


def in_image(points_px: Array) -> NDArray[np.bool_]:
    """Which pixels (N, 2) lie in the simulated camera's image; NaN does not."""
    inside: NDArray[np.bool_] = np.all(
        (points_px >= 0) & (points_px <= [CAMERA.width - 1, CAMERA.height - 1]), axis=1
    )
    return inside
