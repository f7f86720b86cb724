"""Files of the ASL layout (EuRoC, TUM-VI, Kalibr): calibrations, poses, rows of ``data.csv``.

Real files differ: some are OpenCV's dialect of YAML, some have Windows' line ends, no ``#`` before
the header, or five digits. What can only mean one thing is read; anything else is an error that
names file and line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from covinz import frames
from covinz.config import ConfigError
from covinz.trajectory import Trajectory, TrajectoryError
from covinz.types import Array, Camera

# Columns of a file of poses: stamp, position, quaternion; with velocity and both biases.
_POSE_COLUMNS = (8, 17)
_POLYNOMIAL = ("radial-tangential", "radtan", "radial_tangential", "plumb_bob")
_FISHEYE = ("equidistant", "equi")
_STAMP = re.compile(r"[0-9]{1,19}")
# A rotation written with few digits is one up to this and is made one.
_ROTATION_TOLERANCE = 1e-3


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices, which are mappings."""


def _opencv_matrix(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


@dataclass(frozen=True, slots=True)
class _Entries:
    """Entries of a YAML mapping, and the lines they are on."""

    path: Path
    values: dict[str, Any]
    lines: dict[str, int]

    def error(self, name: str, what: str) -> ConfigError:
        """An error about an entry."""
        where = f"{self.path}:{self.lines[name]}" if name in self.lines else f"{self.path}"
        return ConfigError(f"{where}: {name}: {what}")

    def numbers(self, *names: str) -> tuple[str, Array]:
        """The entry that has one of these names, and its numbers in one row."""
        for name in names:
            if name in self.values:
                return name, self._numbers(name)
        raise ConfigError(f"{self.path}: there is no {' or '.join(names)}")

    def _numbers(self, name: str) -> Array:
        value = self.values[name]
        if isinstance(value, dict):
            value = value.get("data")
        try:
            # YAML takes 1e-5 for a word; numpy reads it.
            values = np.ravel(np.asarray(value).astype(np.float64))
        except (TypeError, ValueError, OverflowError) as error:
            raise self.error(name, "expected numbers") from error
        if not np.isfinite(values).all():
            raise self.error(name, "not all numbers are finite")
        return values


def read_sensor(path: Path, camera: str = "cam0") -> Camera:
    """Read a camera's ``sensor.yaml``, or its part of a Kalibr ``camchain.yaml``.

    ``pinhole`` with ``radial-tangential`` (``radtan``) becomes OPENCV, with a fifth coefficient
    FULL_OPENCV; with ``equidistant`` OPENCV_FISHEYE; with ``none`` PINHOLE.

    Args:
        path: The file.
        camera: Which camera of a ``camchain.yaml``.

    Raises:
        ConfigError: If the file cannot be read, is malformed, of another model, has a wrong
            number of coefficients or a pose that is no rigid transform.
    """
    entries = _entries(path, camera)
    name, size = entries.numbers("resolution")
    if size.shape != (2,) or np.any(size != np.rint(size)) or size.min() < 1:
        raise entries.error(name, "expected width and height in pixels")
    name, intrinsics = entries.numbers("intrinsics")
    if intrinsics.shape != (4,) or intrinsics[:2].min() <= 0:
        raise entries.error(name, "expected fu, fv, cu, cv with positive focal lengths")
    model, coefficients = _distortion(entries)
    params = np.concatenate([intrinsics, coefficients])
    return Camera(model, int(size[0]), int(size[1]), params, _T_body_sensor(entries))


def read_poses(path: Path) -> Trajectory:
    """Read poses of the body: ``timestamp [ns], p x y z, q w x y z``, more columns or none.

    A ``sensor.yaml`` beside the file says where on the body the sensor is, e.g. the markers of a
    motion capture system; without one it is the body itself.

    Returns:
        ``T_world_body``.

    Raises:
        TrajectoryError: If the file cannot be read, a row has not 8 or 17 columns, is not a finite
            pose, or the stamps do not ascend.
        ConfigError: If the ``sensor.yaml`` beside it is malformed.
    """
    stamps: list[int] = []
    poses: list[list[float]] = []
    for number, cells in rows(path):
        where = f"{path}:{number}"
        if len(cells) not in _POSE_COLUMNS:
            raise TrajectoryError(f"{where}: expected 8 or 17 columns, got {len(cells)}")
        try:
            stamp, pose = parse_ns(cells[0]), [float(cell) for cell in cells[1:8]]
        except ValueError as error:
            raise TrajectoryError(f"{where}: {error}") from error
        if not np.isfinite(pose).all() or abs(float(np.linalg.norm(pose[3:])) - 1) > 0.01:
            raise TrajectoryError(f"{where}: not a finite pose with a unit quaternion w x y z")
        if stamps and stamp <= stamps[-1]:
            raise TrajectoryError(f"{where}: the time stamps must ascend")
        stamps.append(stamp)
        poses.append([*pose[:3], *pose[4:], pose[3]])
    if not stamps:
        raise TrajectoryError(f"{path}: there is no pose in it")
    T_world_sensor = frames.transform_from_pose(np.array(poses))
    beside = path.with_name("sensor.yaml")
    if beside.is_file():
        T_body_sensor = _T_body_sensor(_entries(beside))
        T_world_sensor = T_world_sensor @ frames.inverse(T_body_sensor)
    return Trajectory(np.array(stamps, dtype=np.int64), T_world_sensor)


def rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line numbers (from 1) and cells of a ``data.csv`` without comments, header and empty lines.

    Raises:
        TrajectoryError: If the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TrajectoryError(f"cannot read {path}: {error}") from error
    is_first = True
    for number, line in enumerate(text.splitlines(), start=1):
        cells = [cell.strip() for cell in line.split(",")]
        if cells[-1] == "":
            cells.pop()
        if not cells or cells[0].startswith("#"):
            continue
        if not (is_first and cells[0].lower().startswith("timestamp")):
            yield number, cells
        is_first = False


def parse_ns(text: str) -> int:
    """Nanoseconds of a time stamp; raises ValueError when `text` is anything else."""
    if not _STAMP.fullmatch(text) or int(text) >= 2**63:
        raise ValueError(f"not a time stamp in nanoseconds: {text!r}")
    return int(text)


def _distortion(entries: _Entries) -> tuple[str, Array]:
    """COLMAP's name of the model, and its parameters after focal lengths and centre."""
    if (model := entries.values.get("camera_model", "pinhole")) != "pinhole":
        raise entries.error("camera_model", f"only pinhole is known, not {model!r}")
    kind = str(entries.values.get("distortion_model", "none")).lower()
    given = np.empty(0)
    name = "distortion_coefficients"
    if kind != "none" or name in entries.values:
        name, given = entries.numbers(name, "distortion_coeffs")
    if kind == "none" and not given.any():
        return "PINHOLE", np.empty(0)
    if kind in _POLYNOMIAL and len(given) == 4:
        return "OPENCV", given
    if kind in _POLYNOMIAL and len(given) == 5:
        return "FULL_OPENCV", np.concatenate([given, np.zeros(3)])
    if kind in _FISHEYE and len(given) == 4:
        return "OPENCV_FISHEYE", given
    known = {"none": "no coefficients"}
    known |= dict.fromkeys(_POLYNOMIAL, "4 or 5 coefficients")
    known |= dict.fromkeys(_FISHEYE, "4 coefficients")
    if kind in known:
        raise entries.error(name, f"{kind} has {known[kind]}, got {len(given)}")
    raise entries.error(
        "distortion_model", f"{kind!r} is none of radial-tangential, radtan, equidistant, none"
    )


def _T_body_sensor(entries: _Entries) -> Array:
    """Pose of a sensor on the body; Kalibr writes its inverse."""
    name, values = entries.numbers("T_BS", "T_cam_imu")
    if values.shape != (16,):
        raise entries.error(name, f"expected a 4 x 4 matrix, got {len(values)} numbers")
    T = values.reshape(4, 4)
    if not frames.is_rigid(T, _ROTATION_TOLERANCE):
        raise entries.error(name, "not a rigid transform")
    if not frames.is_rigid(T):
        U, _, Vt = np.linalg.svd(T[:3, :3])
        T = frames.transform(U @ Vt, T[:3, 3])
    return T if name == "T_BS" else frames.inverse(T)


def _entries(path: Path, camera: str | None = None) -> _Entries:
    """Entries of a file, or those of a camera where the file has one mapping for each."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        # OpenCV begins with %YAML:1.0, which is not YAML.
        loader = _Loader(f"#{text}" if text.startswith("%") else text)
        nodes = _named_nodes(loader.get_single_node(), path)
        if camera is not None and not {"intrinsics", "resolution"} & nodes.keys():
            if camera not in nodes:
                raise ConfigError(f"{path}: there is neither {camera} nor intrinsics in it")
            nodes = _named_nodes(nodes[camera][1], path)
        values = {
            name: loader.construct_object(value, deep=True) for name, (_, value) in nodes.items()
        }
    except ConfigError:
        raise
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read {path}: {' '.join(str(error).split())}") from error
    return _Entries(path, values, {name: line for name, (line, _) in nodes.items()})


def _named_nodes(node: yaml.Node | None, path: Path) -> dict[str, tuple[int, yaml.Node]]:
    """Line and value of each name in a mapping."""
    if not isinstance(node, yaml.MappingNode):
        where = f"{path}:{node.start_mark.line + 1}" if node is not None else f"{path}"
        raise ConfigError(f"{where}: expected a mapping of names to values")
    return {str(key.value): (key.start_mark.line + 1, value) for key, value in node.value}
