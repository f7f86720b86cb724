"""Plays a recording in the ASL layout of EuRoC, TUM-VI and Kalibr.

A camera's folder has a ``data.csv`` of ``timestamp [ns], filename`` and the images in ``data/``;
Kalibr's has the images alone, named by their time stamps.
"""

from __future__ import annotations

from pathlib import Path

from covinz import asl
from covinz.config import ConfigError
from covinz.scenario import AslAgent
from covinz.trajectory import TrajectoryError
from covinz.types import Camera
from covinz_agents.recording import ListedImage, RecordedImages
from covinz_agents.source import DatasetError

_IMAGE_ENDINGS = (".png", ".jpg", ".jpeg")


class AslRecording(RecordedImages[AslAgent]):
    """A `Source` made of a recording's files.

    Args:
        agent: What to read.

    Raises:
        DatasetError: If the list of images is malformed, or no image of the range has a pose.
        TrajectoryError: If a file of poses is missing or malformed.
        ConfigError: If a calibration is, when poses need it.
    """

    def __init__(self, agent: AslAgent) -> None:
        folder = agent.path / agent.camera
        images = [image for image in list_images(folder) if agent.in_time(image.stamp_ns)]
        super().__init__(agent, images, folder)

    def _read_camera(self, image_size: tuple[int, int]) -> Camera:
        camera = self._agent.read_camera()
        if (camera.width, camera.height) != image_size:
            raise ConfigError(
                f"{self._agent.calibration_file}: the calibration is for "
                f"{camera.width} x {camera.height} pixels, "
                f"the images have {image_size[0]} x {image_size[1]}"
            )
        return camera


def list_images(folder: Path) -> list[ListedImage]:
    """Images of a camera's folder in order of time; a frame's number counts from 0.

    Raises:
        DatasetError: If ``data.csv`` cannot be read, a row has not two columns or no time stamp
            in nanoseconds, or the stamps do not ascend; if there is neither it nor an image.
    """
    if not folder.is_dir():
        raise DatasetError(f"there is no folder {folder}")
    if (folder / "data.csv").exists():
        return _listed(folder)
    if not (found := _named_by_stamp(folder)):
        raise DatasetError(f"{folder}: there is no data.csv, and no image is named by its stamp")
    return found


def _listed(folder: Path) -> list[ListedImage]:
    listed: list[ListedImage] = []
    try:
        for line, cells in asl.rows(folder / "data.csv"):
            where = f"{folder / 'data.csv'}:{line}"
            if len(cells) != 2:
                raise DatasetError(f"{where}: expected timestamp and filename")
            try:
                stamp_ns = asl.parse_ns(cells[0])
            except ValueError as error:
                raise DatasetError(f"{where}: {error}") from error
            if listed and stamp_ns <= listed[-1].stamp_ns:
                raise DatasetError(f"{where}: the time stamps must ascend")
            listed.append(ListedImage(len(listed), stamp_ns, folder / "data" / cells[1]))
    except TrajectoryError as error:
        raise DatasetError(str(error)) from error
    return listed


def _named_by_stamp(folder: Path) -> list[ListedImage]:
    files: dict[int, Path] = {}
    for below in (folder / "data", folder):
        for path in sorted(below.glob("*")):
            if path.suffix.lower() in _IMAGE_ENDINGS and path.stem.isdigit():
                try:
                    stamp_ns = asl.parse_ns(path.stem)
                except ValueError as error:
                    raise DatasetError(f"{path}: {error}") from error
                if stamp_ns in files:
                    raise DatasetError(f"{path}: {files[stamp_ns].name} has the same time stamp")
                files[stamp_ns] = path
    return [ListedImage(i, stamp, path) for i, (stamp, path) in enumerate(sorted(files.items()))]
