"""A room of points seen by two robots, each in an odometry frame of its own: loops with a truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import covinz_core
import numpy as np
import pytest
from numpy.typing import NDArray

from covinz.frames import Array, inverse, so3_exp, transform
from covinz.keyframes import CameraNotFound, KeyframeNotFound, StoreUnavailable
from covinz.types import (
    Camera,
    Features,
    FeatureType,
    Keyframe,
    KeyframeId,
    LoopJob,
    RigMember,
)

SESSIONS = {"a": "01ARZ3NDEKTSV4RRFFQ69G5FAV", "b": "01ARZ3NDEKTSV4RRFFQ69G5FAW"}
T_BODY_CAM = transform(so3_exp([0.1, -0.2, 1.4]), [0.05, 0.02, -0.01])
CAMERA = Camera(
    model="OPENCV",
    width=640,
    height=480,
    params=np.array([460.0, 455.0, 318.0, 242.0, -0.25, 0.06, 2e-4, -1e-4]),
    T_body_cam=T_BODY_CAM,
)


@dataclass
class Store:
    """Keyframes and cameras at hand; can be away for a number of questions."""

    keyframes: dict[KeyframeId, Keyframe] = field(default_factory=dict)
    cameras: dict[str, Camera] = field(default_factory=dict)
    times_away: int = 0

    def keyframe(self, keyframe_id: KeyframeId) -> Keyframe:
        if self.times_away:
            self.times_away -= 1
            raise StoreUnavailable("ingest does not answer")
        if keyframe_id not in self.keyframes:
            raise KeyframeNotFound(f"no keyframe {keyframe_id}")
        return self.keyframes[keyframe_id]

    def camera(self, camera_hash: str) -> Camera:
        if camera_hash not in self.cameras:
            raise CameraNotFound(f"no camera {camera_hash}")
        return self.cameras[camera_hash]


@dataclass(frozen=True)
class Room:
    """Two rigs in one room.

    Attributes:
        store: Their keyframes.
        job: Asks for the pose of ``a``'s keyframe 0 in ``b``'s keyframe 0.
        T_cand_query: (4, 4) the truth.
    """

    store: Store
    job: LoopJob
    T_cand_query: Array


def _look(
    rng: np.random.Generator,
    T_world_body: Array,
    points: Array,
    descriptors: NDArray[np.uint8],
) -> Features:
    T_cam_world = inverse(T_world_body @ CAMERA.T_body_cam)
    points_cam = points @ T_cam_world[:3, :3].T + T_cam_world[:3, 3]
    pixels = covinz_core.project_points(CAMERA.model, CAMERA.params.tolist(), points_cam)
    pixels += rng.normal(scale=0.3, size=pixels.shape)
    inside = (pixels >= 0).all(axis=1) & (pixels < [CAMERA.width, CAMERA.height]).all(axis=1)
    flips = rng.random((int(inside.sum()), 256)) < 0.03
    seen = descriptors[inside] ^ np.packbits(flips, axis=1)
    return Features(FeatureType.ORB, pixels[inside].astype(np.float32), seen)


def _body_poses(rng: np.random.Generator, count: int, shift_m: Array) -> list[Array]:
    """Bodies whose cameras look at the room's far wall, some decimetres apart.

    Not along one line: from two rigs in straight motion the linear 17-point method gets no pose.
    """
    steps_m = np.array([[0.0, 0.0, 0.0], [0.4, 0.1, -0.2], [-0.1, 0.4, 0.2]])
    poses = []
    for i in range(count):
        R = so3_exp(rng.normal(scale=0.05, size=3))
        T_world_cam = transform(R, shift_m + steps_m[i])
        poses.append(T_world_cam @ inverse(CAMERA.T_body_cam))
    return poses


def build_room(num_points: int = 700, seed: int = 5, moved_m: float = 0.0) -> Room:
    """Every other point has moved by so much when the second robot comes."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-4, -3, 3], [4, 3, 8], (num_points, 3))
    descriptors = rng.integers(0, 256, (num_points, 32), dtype=np.uint8)
    store = Store(cameras={CAMERA.hash: CAMERA})
    members: dict[str, list[RigMember]] = {"a": [], "b": []}
    truth: dict[str, Array] = {}
    for agent, count, shift in (("a", 2, [0.3, -0.2, 0.1]), ("b", 3, [0.0, 0.0, 0.0])):
        if agent == "b":
            points[::2, 0] += moved_m
        T_odom_world = transform(so3_exp(rng.normal(size=3)), rng.normal(scale=5.0, size=3))
        for seq, T_world_body in enumerate(_body_poses(rng, count, np.array(shift))):
            kf = Keyframe(
                id=KeyframeId(agent, SESSIONS[agent], seq),
                stamp_ns=seq,
                T_odom_body=T_odom_world @ T_world_body,
                camera_hash=CAMERA.hash,
                features=_look(rng, T_world_body, points, descriptors),
            )
            store.keyframes[kf.id] = kf
            members[agent].append(RigMember(kf.id, kf.T_odom_body, kf.camera_hash))
            truth.setdefault(agent, T_world_body)
    job = LoopJob(
        "00112233445566778899aabbccddeeff", tuple(members["a"]), tuple(members["b"]), 50.0
    )
    return Room(store, job, inverse(truth["b"]) @ truth["a"])


@pytest.fixture
def room() -> Room:
    return build_room()


@pytest.fixture
def torn_room() -> Room:
    """Half of the points have moved: two poses are equally good."""
    return build_room(moved_m=1.0)


@pytest.fixture
def bare_room() -> Room:
    """Too few points for a loop."""
    return build_room(num_points=25)
