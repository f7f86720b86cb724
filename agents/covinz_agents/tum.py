"""Plays a recording in the layout of the TUM RGB-D data sets.

``rgb.txt`` lists ``timestamp filename``; odometry and ground truth are TUM trajectory files. Time
stamps are integer nanoseconds throughout, so that a stamp in one file is found in another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.calibration import read_camera
from covinz.scenario import (
    FileOdometry,
    TumAgent,
    read_body_poses,
    recorded_groundtruth,
)
from covinz.trajectory import Trajectory, TrajectoryError, parse_stamp_ns, table
from covinz.types import Array, Camera, Features
from covinz_agents.drift import drifting_odometry
from covinz_agents.features import extract
from covinz_agents.source import DatasetError, Frame


@dataclass(frozen=True, slots=True)
class ListedImage:
    """A line of ``rgb.txt``: frame number, time of exposure and file."""

    number: int
    stamp_ns: int
    path: Path


class TumRecording:
    """A `Source` made of a recording's files.

    Odometry begins at the identity with the first frame used, whatever frame the file is in:
    robots that play parts of one recording share no frame.

    Args:
        agent: What to read.

    Raises:
        DatasetError: If the list of images is malformed, or no image of the range has a pose.
        TrajectoryError: If a trajectory file is missing or malformed.
        ConfigError: If the calibration is.
    """

    def __init__(self, agent: TumAgent) -> None:
        self._agent = agent
        self._groundtruth = recorded_groundtruth(agent)
        images = select_images(read_image_list(agent.path, agent.images), agent)
        if not images:
            raise DatasetError(f"{agent.path / agent.images}: no image in the range asked for")
        self._frames, self._files = _frames(agent, images, self._groundtruth)
        if not self._frames:
            raise DatasetError(f"{agent.path}: no image of the range has an odometry pose")
        self._skipped = len(images) - len(self._frames)

    @cached_property
    def camera(self) -> Camera:
        """Calibration; the first image gives the size."""
        height, width = read_image(self._files[self._frames[0].number]).shape[:2]
        return read_camera(self._agent.path / self._agent.camera, (width, height))

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

    def features(self, frame: Frame) -> Features:
        """Features of a frame's image; raises DatasetError when it cannot be read."""
        return extract(read_image(self._files[frame.number]), self._agent.features)


def read_image_list(folder: Path, images: Path) -> list[ListedImage]:
    """Read ``rgb.txt``.

    Frames have the number that is their file's name where every name is one, else their row.

    Raises:
        DatasetError: If the file cannot be read, a line has not two columns or no decimal time
            stamp, or the stamps do not ascend.
    """
    listed: list[tuple[int, Path]] = []
    try:
        for number, words in table(folder / images):
            where = f"{folder / images}:{number}"
            if len(words) != 2:
                raise DatasetError(f"{where}: expected timestamp and filename")
            try:
                stamp_ns = parse_stamp_ns(words[0])
            except ValueError as error:
                raise DatasetError(f"{where}: {error}") from error
            if listed and stamp_ns <= listed[-1][0]:
                raise DatasetError(f"{where}: the time stamps must ascend")
            listed.append((stamp_ns, folder / words[1]))
    except TrajectoryError as error:
        raise DatasetError(str(error)) from error
    numbered = all(path.stem.isascii() and path.stem.isdigit() for _, path in listed)
    return [
        ListedImage(int(path.stem) if numbered else row, stamp_ns, path)
        for row, (stamp_ns, path) in enumerate(listed)
    ]


def select_images(images: Sequence[ListedImage], agent: TumAgent) -> list[ListedImage]:
    """The images in the agent's range of frames or times; both ends belong to it."""
    if agent.frames is not None:
        first, last = agent.frames
        return [image for image in images if first <= image.number <= last]
    if agent.times_s is not None:
        start_ns, end_ns = (parse_stamp_ns(text) for text in agent.times_s)
        return [image for image in images if start_ns <= image.stamp_ns <= end_ns]
    return list(images)


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
    agent: TumAgent, images: Sequence[ListedImage], groundtruth: Trajectory | None
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


def _odometry(agent: TumAgent, poses: Array) -> Array:
    if isinstance(agent.odometry, FileOdometry):
        return frames.inverse(poses[:1]) @ poses
    return drifting_odometry(poses, agent.odometry.drift, agent.id)
