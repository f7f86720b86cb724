"""Calibration files of recorded data sets: covinz's ``calib.yaml`` and TUM's ``calib.txt``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from covinz import frames
from covinz.config import ConfigError, PositiveInt, Section, read_yaml, validate
from covinz.trajectory import TrajectoryError, table
from covinz.types import NUM_CAMERA_PARAMS, Array, Camera


class CalibrationFile(Section):
    """Contents of ``calib.yaml``."""

    # COLMAP's name of the camera model, ...
    model: Literal["PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"]
    # ... the image size in pixels ...
    width: PositiveInt
    height: PositiveInt
    # ... and its parameters in COLMAP's order.
    params: tuple[float, ...]
    # Pose of the camera in the body frame, 16 numbers row by row.
    T_body_cam: tuple[float, ...] = tuple(np.eye(4).ravel().tolist())
    # Seconds from the exposure of the first row to that of the last; 0: a global shutter, stamped
    # at the middle of the exposure. Absent when unknown. [docs/agents.md]
    readout_s: Annotated[float, Field(ge=0, le=1)] | None = None


def read_camera(path: Path, image_size: tuple[int, int]) -> Camera:
    """Read the calibration of images of a size (width, height).

    A ``.txt`` file is TUM's: one line ``fx fy cx cy k1 k2 p1 p2 k3``, which becomes FULL_OPENCV
    with the body in the camera. Anything else is read as `CalibrationFile`.

    Raises:
        ConfigError: If the file cannot be read, is malformed, has a wrong number of parameters,
            is for images of another size or has a `T_body_cam` that is no rigid transform.
    """
    if path.suffix == ".txt":
        params, T_body_cam = _tum_params(path), np.eye(4)
        return Camera("FULL_OPENCV", *image_size, params, T_body_cam)
    entries = validate(CalibrationFile, read_yaml(path), str(path))
    if (entries.width, entries.height) != image_size:
        raise ConfigError(
            f"{path}: the calibration is for {entries.width} x {entries.height} pixels, "
            f"the images have {image_size[0]} x {image_size[1]}"
        )
    return camera_of(entries, str(path))


def camera_of(entries: CalibrationFile, origin: str) -> Camera:
    """The camera that a calibration describes.

    Args:
        entries: The calibration.
        origin: Where it is from, for messages.

    Raises:
        ConfigError: If the number of parameters is wrong, one is not usable, or `T_body_cam` is no
            rigid transform.
    """
    if len(entries.params) != NUM_CAMERA_PARAMS[entries.model]:
        raise ConfigError(
            f"{origin}: {entries.model} has {NUM_CAMERA_PARAMS[entries.model]} parameters"
        )
    return Camera(
        entries.model,
        entries.width,
        entries.height,
        _checked_params(np.array(entries.params), origin),
        _T_body_cam(entries, origin),
        entries.readout_s,
    )


def read_T_body_cam(path: Path) -> Array:
    """Pose (4, 4) of the camera in the body frame; the identity for TUM's ``calib.txt``.

    Raises:
        ConfigError: As `read_camera`.
    """
    if path.suffix == ".txt":
        return np.eye(4)
    return _T_body_cam(validate(CalibrationFile, read_yaml(path), str(path)), str(path))


def _T_body_cam(entries: CalibrationFile, origin: str) -> Array:
    if len(entries.T_body_cam) != 16:
        raise ConfigError(f"{origin}: T_body_cam has 16 numbers, got {len(entries.T_body_cam)}")
    T_body_cam = np.reshape(entries.T_body_cam, (4, 4))
    if not frames.is_rigid(T_body_cam):
        raise ConfigError(f"{origin}: T_body_cam is not a rigid transform")
    return T_body_cam


def _tum_params(path: Path) -> Array:
    try:
        rows = list(table(path))
    except TrajectoryError as error:
        raise ConfigError(str(error)) from error
    if len(rows) != 1 or len(rows[0][1]) != 9:
        raise ConfigError(f"{path}: expected one line fx fy cx cy k1 k2 p1 p2 k3")
    number, words = rows[0]
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise ConfigError(f"{path}:{number}: {error}") from error
    return _checked_params(np.concatenate([values, np.zeros(3)]), str(path))


def _checked_params(params: Array, origin: str) -> Array:
    if not np.isfinite(params).all() or params[:2].min() <= 0:
        raise ConfigError(f"{origin}: the parameters must be finite, focal lengths positive")
    return params
