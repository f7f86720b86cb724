"""Generated runs of two robots past one place: whole tracks of keyframes, to choose rigs from.

Keyframes are 0.12 to 0.2 m apart and turn by about 2 degrees; odometry is a random walk. Both
robots see the same landmarks. A keyframe finds a landmark in its view with a probability of 0.7,
halved when its direction differs by 17 degrees from that at the place, or its distance 1.6 times;
about a quarter of the matches are wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import covinz_core
import numpy as np
from numpy.typing import NDArray

from benchmarks.fleet import Fleet
from covinz import frames
from covinz.config import OdometryNoise
from covinz.types import Array, Camera, Features, FeatureType, Keyframe, KeyframeId

KEYFRAMES = 41
# The keyframe in the middle of each track, where the robots meet.
_PLACE = KEYFRAMES // 2
_SESSIONS = {"cand": "01ARZ3NDEKTSV4RRFFQ69G5FA0", "query": "01ARZ3NDEKTSV4RRFFQ69G5FA1"}
# The body's x axis looks ahead, z is up.
_CAMERA = Camera(
    "PINHOLE",
    752,
    480,
    np.array([458.0, 458.0, 375.5, 239.5]),
    frames.transform(
        np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [0.05, 0.03, -0.02]
    ),
)
_SIZE_PX = (_CAMERA.width, _CAMERA.height)
_LANDMARKS, _WRONG = 300, 450
_NOISE_PX = 1.0
_FOUND = 0.7
_DIRECTION_RAD, _LOG_DISTANCE = np.deg2rad(20), 0.6


@dataclass(frozen=True, slots=True)
class Track:
    """A kind of run.

    Attributes:
        forward: The robots drive where they look, else in any one direction.
        depth_m: Range of the depths of landmarks.
        noise: What the odometry is like, and is said to be like.
    """

    forward: bool
    depth_m: tuple[float, float]
    noise: OdometryNoise


_GOOD = OdometryNoise(
    rotation_per_sqrt_m=0.003,
    rotation_per_sqrt_rad=0.006,
    translation_per_sqrt_m=0.01,
    translation_per_sqrt_rad=0.01,
)
TRACKS: Mapping[str, Track] = {
    f"{motion}_{scene}{suffix}": Track(motion == "forward", depth_m, noise)
    for suffix, noise in (("", OdometryNoise()), ("_good_odometry", _GOOD))
    for motion in ("any", "forward")
    for scene, depth_m in (("desk", (0.8, 2.5)), ("room", (1.5, 5.0)), ("hall", (4.0, 15.0)))
}


def generate(track: Track, seed: int) -> tuple[Fleet, KeyframeId, KeyframeId]:
    """The robots' keyframes, and those of query and candidate that meet.

    The query is the newest keyframe in the log; the candidate's robot has gone on.
    """
    rng = np.random.default_rng(seed)
    true, odometry = zip(*(_walk(track, rng) for _ in _SESSIONS), strict=True)
    T_cand_query = _meeting(rng)
    T_world_body = {"cand": true[0], "query": T_cand_query @ true[1]}
    scene = _Scene(track, rng)
    keyframes: dict[KeyframeId, Keyframe] = {}
    poses: dict[KeyframeId, Array] = {}
    for name, T_odom_body in zip(_SESSIONS, odometry, strict=True):
        for seq in range(KEYFRAMES if name == "cand" else _PLACE + 1):
            kf_id = KeyframeId(name, _SESSIONS[name], seq)
            T = T_world_body[name][seq]
            keyframes[kf_id] = Keyframe(
                kf_id, seq * 10**9, T_odom_body[seq], _CAMERA.hash, scene.features(T, name)
            )
            poses[kf_id] = T
    query, cand = (KeyframeId(name, _SESSIONS[name], _PLACE) for name in ("query", "cand"))
    settings = {
        "loop_solver": {"fast": {"odometry": track.noise.model_dump(mode="json")}},
    }
    return Fleet(settings, keyframes, {_CAMERA.hash: _CAMERA}, poses, {}), query, cand


def _walk(track: Track, rng: np.random.Generator) -> tuple[Array, Array]:
    """True poses, the one in the middle the identity, and odometry, (KEYFRAMES, 4, 4)."""
    heading = 0.0 if track.forward else rng.uniform(-np.pi, np.pi)
    yaw_rad = rng.normal(scale=np.deg2rad(2))
    true, odometry = [np.eye(4)], [np.eye(4)]
    noise = covinz_core.OdometryNoise(**track.noise.model_dump())
    for _ in range(KEYFRAMES - 1):
        angle = heading + rng.normal(scale=0.3)
        direction = np.array([np.cos(angle), np.sin(angle), rng.normal(scale=0.2)])
        turn = rng.normal(scale=np.deg2rad(2) / 3, size=3)
        turn[2] += yaw_rad
        moved = rng.uniform(0.12, 0.2) * direction / np.linalg.norm(direction)
        step = frames.transform(frames.so3_exp(turn), moved)
        error = np.sqrt(np.diag(covinz_core.random_walk(step, noise))) * rng.normal(size=6)
        true.append(true[-1] @ step)
        odometry.append(
            odometry[-1] @ step @ frames.transform(frames.so3_exp(error[:3]), error[3:])
        )
    return frames.inverse(true[_PLACE]) @ np.stack(true), np.stack(odometry)


def _meeting(rng: np.random.Generator) -> Array:
    direction = rng.normal(size=3)
    turn = rng.normal(scale=np.deg2rad(3) / np.sqrt(3), size=3)
    turn[2] = rng.uniform(-1, 1) * np.deg2rad(25)
    distance = rng.uniform(0.1, 1.0)
    return frames.transform(frames.so3_exp(turn), distance * direction / np.linalg.norm(direction))


class _Scene:
    """Landmarks in the view of the candidate, and things that robots take for one another."""

    def __init__(self, track: Track, rng: np.random.Generator) -> None:
        self._rng = rng
        pixels = rng.uniform((0, 0), _SIZE_PX, (_LANDMARKS, 2))
        rays = np.column_stack(
            [(pixels - _CAMERA.params[2:]) / _CAMERA.params[:2], np.ones(_LANDMARKS)]
        )
        points = rays * rng.uniform(*track.depth_m, (_LANDMARKS, 1))
        T = _CAMERA.T_body_cam
        self._points = points @ T[:3, :3].T + T[:3, 3]
        self._from_place = self._points - T[:3, 3]
        self._descriptors = rng.integers(0, 256, (_LANDMARKS, 32), dtype=np.uint8)
        self._alike = rng.integers(0, 256, (_WRONG, 32), dtype=np.uint8)

    def features(self, T_world_body: Array, robot: str) -> Features:
        """What a keyframe sees."""
        pixels, found = self._look(T_world_body @ _CAMERA.T_body_cam)
        # Each of these is in a third of a robot's keyframes, anywhere.
        (alike,) = np.nonzero(self._rng.random(_WRONG) < 1 / 3)
        anywhere = self._rng.uniform((0, 0), _SIZE_PX, (len(alike), 2))
        keypoints = np.concatenate([pixels[found], anywhere])
        descriptors = np.concatenate([self._descriptors[found], self._alike[alike]])
        flips = self._rng.random((len(descriptors), 256)) < 0.05
        return Features(
            FeatureType.ORB,
            keypoints.clip(0, np.array(_SIZE_PX) - 1).astype(np.float32),
            descriptors ^ np.packbits(flips, axis=1),
        )

    def _look(self, T_world_cam: Array) -> tuple[Array, NDArray[np.bool_]]:
        rays = self._points - T_world_cam[:3, 3]
        points = rays @ T_world_cam[:3, :3]
        depth = np.where(points[:, 2:] > 0.1, points[:, 2:], np.nan)
        pixels = _CAMERA.params[:2] * points[:, :2] / depth + _CAMERA.params[2:]
        pixels += self._rng.normal(scale=_NOISE_PX, size=pixels.shape)
        inside = ((pixels >= 0) & (pixels <= np.array(_SIZE_PX) - 1)).all(axis=1)
        lengths = [np.linalg.norm(each, axis=1) for each in (rays, self._from_place)]
        cosine = (rays * self._from_place).sum(axis=1) / np.prod(lengths, axis=0)
        turned = np.arccos(cosine.clip(-1, 1)) / _DIRECTION_RAD
        nearer = np.log(lengths[0] / lengths[1]) / _LOG_DISTANCE
        chance = _FOUND * np.exp(-(turned**2) - nearer**2)
        return pixels, inside & (self._rng.random(len(pixels)) < chance)
