"""What recordings of all layouts share: listed images that are given poses of a trajectory file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.scenario import (
    AslAgent,
    FileOdometry,
    TumAgent,
    read_body_poses,
    recorded_groundtruth,
)
from covinz.trajectory import Trajectory
from covinz.types import Array, Camera, Features
from covinz_agents.drift import drifting_odometry
from covinz_agents.features import extract, extract_kinds
from covinz_agents.source import DatasetError, Frame

A = TypeVar("A", bound=TumAgent | AslAgent)


@dataclass(frozen=True, slots=True)
class ListedImage:
    """An image that a recording lists: frame number, time of exposure and file."""

    number: int
    stamp_ns: int
    path: Path


class RecordedImages(ABC, Generic[A]):
    """A `Source` made of image files and trajectory files.

    Odometry begins at the identity with the first frame used, whatever frame the file is in:
    robots that play parts of one recording share no frame.

    Args:
        agent: What to read.
        images: Images of the range to use, in order of time.
        listed_in: File or folder that they were listed in.

    Raises:
        DatasetError: If there is no image, or none that has a pose.
        TrajectoryError: If a trajectory file is missing or malformed.
        ConfigError: If the calibration is, when poses of the camera need it.
    """

    def __init__(self, agent: A, images: Sequence[ListedImage], listed_in: Path) -> None:
        self._agent = agent
        if not images:
            raise DatasetError(f"{listed_in}: no image in the range asked for")
        self._groundtruth = recorded_groundtruth(agent)
        self._frames, self._files = _frames(agent, images, self._groundtruth)
        if not self._frames:
            raise DatasetError(f"{agent.path}: no image of the range has an odometry pose")
        self._skipped = len(images) - len(self._frames)

    @abstractmethod
    def _read_camera(self, image_size: tuple[int, int]) -> Camera:
        """The calibration of images of a size (width, height); raises ConfigError."""

    @cached_property
    def camera(self) -> Camera:
        """Calibration of all images, which have the size of the first."""
        height, width = read_image(self._files[self._frames[0].number]).shape[:2]
        return self._read_camera((width, height))

    @property
    def frames(self) -> Sequence[Frame]:
        """All images of the range that have an odometry pose."""
        return self._frames

    @property
    def skipped(self) -> int:
        """Images of the range without one."""
        return self._skipped

    @property
    def groundtruth(self) -> Trajectory | None:
        """True poses ``T_world_body`` of the whole recording."""
        return self._groundtruth

    def image(self, frame: Frame) -> NDArray[np.uint8]:
        """A frame's image (H, W), grey.

        Raises:
            DatasetError: If it cannot be read or has another size than the first.
        """
        path = self._files[frame.number]
        image = read_image(path)
        height, width = image.shape
        if (width, height) != (self.camera.width, self.camera.height):
            raise DatasetError(
                f"{path} has {width} x {height} pixels, "
                f"the calibration is for {self.camera.width} x {self.camera.height}"
            )
        return image

    def features(self, frame: Frame) -> Features:
        """Features of a frame's image, of the first kind; raises DatasetError as `image`."""
        return extract(self.image(frame), self._agent.features)

    def all_features(self, frame: Frame) -> tuple[Features, ...]:
        """Features of a frame's image, one block for each kind; raises as `image`."""
        return extract_kinds(self.image(frame), self._agent.features)


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image file as grey (H, W) uint8; raises DatasetError naming it."""
    try:
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise DatasetError(f"cannot read the image {path}: {error.strerror}") from error
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    if image is None:
        raise DatasetError(f"{path} is not an image")
    return np.asarray(image, dtype=np.uint8)


def _frames(
    agent: TumAgent | AslAgent, images: Sequence[ListedImage], groundtruth: Trajectory | None
) -> tuple[list[Frame], dict[int, Path]]:
    """Frames of the images that have a pose, and the file of each frame number."""
    if isinstance(agent.odometry, FileOdometry):
        source = read_body_poses(agent, agent.odometry.file, agent.odometry.frame)
    else:
        assert groundtruth is not None  # checked by the scenario
        source = groundtruth
    max_gap_ns = round(agent.max_pose_gap_s * 1e9)
    poses, found = source.sample([image.stamp_ns for image in images], max_gap_ns)
    with_pose = [images[i] for i in found]
    made = [
        Frame(image.number, image.stamp_ns, T)
        for image, T in zip(with_pose, _odometry(agent, poses), strict=True)
    ]
    return made, {image.number: image.path for image in with_pose}


def _odometry(agent: TumAgent | AslAgent, poses: Array) -> Array:
    if isinstance(agent.odometry, FileOdometry):
        return frames.inverse(poses[:1]) @ poses
    return drifting_odometry(poses, agent.odometry.drift, agent.id)
