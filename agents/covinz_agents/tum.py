"""Plays a recording in the layout of the TUM RGB-D data sets.

``rgb.txt`` lists ``timestamp filename``; odometry and ground truth are TUM trajectory files. Time
stamps are integer nanoseconds throughout, so that a stamp in one file is found in another.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from covinz.calibration import read_camera
from covinz.scenario import TumAgent
from covinz.trajectory import TrajectoryError, parse_stamp_ns, table
from covinz.types import Camera
from covinz_agents.recording import ListedImage, RecordedImages
from covinz_agents.source import DatasetError


class TumRecording(RecordedImages[TumAgent]):
    """A `Source` made of a recording's files.

    Args:
        agent: What to read.

    Raises:
        DatasetError: If the list of images is malformed, or no image of the range has a pose.
        TrajectoryError: If a trajectory file is missing or malformed.
        ConfigError: If the calibration is, when poses of the camera need it.
    """

    def __init__(self, agent: TumAgent) -> None:
        images = select_images(read_image_list(agent.path, agent.images), agent)
        super().__init__(agent, images, agent.path / agent.images)

    def _read_camera(self, image_size: tuple[int, int]) -> Camera:
        return read_camera(self._agent.path / self._agent.camera, image_size)


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
    return [image for image in images if agent.in_time(image.stamp_ns)]
