"""A robot with a real camera in a real room, small enough for tests: every pixel is ray-traced.

The room is a textured box. Rays leave the lens by the camera's own model, so that images, poses
and calibration agree, whatever the model.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from covinz_agents.features import extract
from covinz_agents.source import Frame
from numpy.typing import NDArray

from covinz import frames
from covinz.config import FeatureConfig
from covinz.trajectory import Trajectory
from covinz.types import Array, Camera, Features

START_NS = 1_403_636_579_763_555_584
STEP_NS = 100_000_001
ROOM_M = np.array([6.0, 5.0, 3.0])
_TEXELS_PER_M = 100

# x of the body is ahead; a hand's breadth ahead and a bit turned, so that it matters.
T_BODY_CAM = frames.transform(
    np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]) @ frames.so3_exp([0.02, -0.03, 0.01]),
    [0.1, 0.03, 0.05],
)
CAMERAS = {
    "PINHOLE": Camera("PINHOLE", 320, 240, np.array([195.3, 195.7, 160.2, 119.1]), T_BODY_CAM),
    "OPENCV": Camera(
        "OPENCV",
        320,
        240,
        np.array([195.3, 195.7, 160.2, 119.1, -0.2834, 0.0740, 1.9359e-4, 1.7619e-5]),
        T_BODY_CAM,
    ),
    "FULL_OPENCV": Camera(
        "FULL_OPENCV",
        320,
        240,
        np.array([195.3, 195.7, 160.2, 119.1, -0.28, 0.07, 2e-4, 1e-5, 0.01, 0, 0, 0]),
        T_BODY_CAM,
    ),
    "OPENCV_FISHEYE": Camera(
        "OPENCV_FISHEYE",
        320,
        240,
        np.array([150.1, 150.2, 160.2, 119.1, 3.4e-3, 7e-4, -2e-3, 2e-4]),
        T_BODY_CAM,
    ),
}


class RoomRobot:
    """A `Source` with images: one robot on an arc through the room, looking outwards.

    Args:
        model: Which of `CAMERAS`.
        num_frames: How many images.
        start_rad: Where on its circle it starts.
        T_odom_drift: (4, 4) error of the odometry per image.
    """

    def __init__(
        self,
        model: str = "OPENCV",
        num_frames: int = 8,
        start_rad: float = 0.0,
        T_odom_drift: Array | None = None,
    ) -> None:
        self.camera = CAMERAS[model]
        self.skipped = 0
        angle = start_rad + 0.12 * np.arange(num_frames)
        yaw = frames.so3_exp(angle[:, None] * [0.0, 0.0, 1.0])
        place = np.stack([np.cos(angle), np.sin(angle), 0.05 * np.sin(7 * angle)], axis=1)
        stamps_ns = START_NS + STEP_NS * np.arange(num_frames)
        self.groundtruth = Trajectory(stamps_ns, frames.transform(yaw, place * [1.2, 1.0, 1.0]))
        self._rays = _rays(self.camera)
        poses = frames.inverse(self.groundtruth.T_ref_body[:1]) @ self.groundtruth.T_ref_body
        drift = np.eye(4) if T_odom_drift is None else T_odom_drift
        drifted = [T @ np.linalg.matrix_power(drift, i) for i, T in enumerate(poses)]
        self.frames: Sequence[Frame] = [
            Frame(i, stamp_ns, T)
            for i, (stamp_ns, T) in enumerate(zip(stamps_ns.tolist(), drifted, strict=True))
        ]

    def image(self, frame: Frame) -> NDArray[np.uint8]:
        """The image (H, W), grey."""
        return _look(self.groundtruth.T_ref_body[frame.number] @ T_BODY_CAM, self._rays)

    def features(self, frame: Frame) -> Features:
        """Features of a frame's image."""
        return extract(self.image(frame), FeatureConfig())

    def all_features(self, frame: Frame) -> tuple[Features, ...]:
        """The same as one block."""
        return (self.features(frame),)


def _rays(camera: Camera) -> Array:
    """Directions (H, W, 3) in the camera's frame of all pixels."""
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    fx, fy, cx, cy = camera.params[:4]
    K, D = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), camera.params[4:]
    points = pixels.reshape(-1, 1, 2).astype(np.float64)
    if camera.model == "OPENCV_FISHEYE":
        plane = cv2.fisheye.undistortPoints(points, K, D)
    else:
        plane = cv2.undistortPoints(points, K, D if len(D) else None)
    plane = np.asarray(plane).reshape(camera.height, camera.width, 2)
    return np.concatenate([plane, np.ones((camera.height, camera.width, 1))], axis=-1)


def _look(T_world_cam: Array, rays: Array) -> NDArray[np.uint8]:
    """What a camera inside of the room sees."""
    ray = rays @ T_world_cam[:3, :3].T
    start = T_world_cam[:3, 3]
    with np.errstate(divide="ignore"):
        reach = (np.sign(ray) * ROOM_M / 2 - start) / ray
    axis = np.argmin(reach, axis=-1)
    hit = start + ray * np.take_along_axis(reach, axis[..., None], axis=-1)
    image = np.zeros(axis.shape, dtype=np.uint8)
    for wall_axis in range(3):
        u, v = (hit[..., other] for other in range(3) if other != wall_axis)
        far = np.take(ray, wall_axis, axis=-1) > 0
        for side in (False, True):
            seen = cv2.remap(
                _texture(2 * wall_axis + side),
                ((u + 3.5) * _TEXELS_PER_M).astype(np.float32),
                ((v + 3.5) * _TEXELS_PER_M).astype(np.float32),
                cv2.INTER_LINEAR,
            )
            image = np.where((axis == wall_axis) & (far == side), seen, image)
    return image.astype(np.uint8)


def _texture(wall: int) -> NDArray[np.uint8]:
    """A wall's texture: blocks of several sizes."""
    if wall not in _TEXTURES:
        rng = np.random.default_rng(wall)
        size = 7 * _TEXELS_PER_M
        image = np.zeros((size, size))
        for block, weight in ((4, 0.3), (11, 0.4), (40, 0.3)):
            cells = rng.integers(256, size=(-(-size // block), -(-size // block)))
            image += weight * np.kron(cells, np.ones((block, block)))[:size, :size]
        _TEXTURES[wall] = cv2.GaussianBlur(image, (0, 0), 0.8).astype(np.uint8)
    return _TEXTURES[wall]


_TEXTURES: dict[int, NDArray[np.uint8]] = {}
