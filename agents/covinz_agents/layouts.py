"""Writes what a robot saw as a recording: ASL or TUM layout, for covinz and for other SLAM systems.

Images are grey and lossless, so that their features are the robot's, bit by bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from covinz import frames
from covinz.trajectory import Trajectory, format_stamp_ns, write_tum
from covinz.types import Array, Camera
from covinz_agents.source import DatasetError, Source

ODOMETRY = Path("odometry.tum")
# Called with the number of images written so far.
Progress = Callable[[int], None]


def write_asl(folder: Path, robot: Source, progress: Progress = lambda _: None) -> None:
    """Write a robot's images, calibration and true poses in the ASL layout of EuRoC.

    Odometry, which the layout has no place for, is in `ODOMETRY`: ``T_odom_body``.

    Args:
        folder: Where ``mav0`` is made.
        robot: What to write.
        progress: Told after each image.

    Raises:
        DatasetError: If the layout has no name for the camera's model, or an image cannot be had.
    """
    camera = folder / "mav0" / "cam0"
    (camera / "data").mkdir(parents=True)
    (camera / "sensor.yaml").write_text(_sensor_yaml(robot.camera))
    lines = ["#timestamp [ns],filename"]
    for count, frame in enumerate(robot.frames, start=1):
        name = f"{frame.stamp_ns}.png"
        _write_png(camera / "data" / name, robot.image(frame))
        lines.append(f"{frame.stamp_ns},{name}")
        progress(count)
    (camera / "data.csv").write_text("\n".join([*lines, ""]))
    _write_odometry(folder, robot)
    if robot.groundtruth is not None:
        truth = folder / "mav0" / "state_groundtruth_estimate0"
        truth.mkdir()
        (truth / "data.csv").write_text(_pose_csv(robot.groundtruth))


def write_tum_layout(folder: Path, robot: Source, progress: Progress = lambda _: None) -> None:
    """Write a robot's images, calibration, odometry and true poses in the layout of TUM RGB-D.

    Poses are the body's: ``T_odom_body`` in `ODOMETRY`, ``T_world_body`` in ``groundtruth.txt``.

    Args:
        folder: Where ``rgb.txt`` is made.
        robot: What to write.
        progress: Told after each image.

    Raises:
        DatasetError: If an image cannot be had.
    """
    (folder / "rgb").mkdir(parents=True)
    camera = robot.camera
    calibration = {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "params": camera.params.tolist(),
        "T_body_cam": camera.T_body_cam.ravel().tolist(),
    }
    (folder / "calib.yaml").write_text(yaml.safe_dump(calibration, sort_keys=False))
    lines = ["# timestamp filename"]
    for count, frame in enumerate(robot.frames, start=1):
        stamp = format_stamp_ns(frame.stamp_ns)
        _write_png(folder / "rgb" / f"{stamp}.png", robot.image(frame))
        lines.append(f"{stamp} rgb/{stamp}.png")
        progress(count)
    (folder / "rgb.txt").write_text("\n".join([*lines, ""]))
    _write_odometry(folder, robot)
    if robot.groundtruth is not None:
        write_tum(folder / "groundtruth.txt", robot.groundtruth, "T_world_body")


# How to write a layout, and what of an agent's entry in a scenario names its files.
Writer = Callable[[Path, Source, Progress], None]
LAYOUTS: Final[Mapping[str, tuple[Writer, Mapping[str, object]]]] = {
    "asl": (write_asl, {"groundtruth": "mav0/state_groundtruth_estimate0/data.csv"}),
    "tum": (write_tum_layout, {"groundtruth": {"file": "groundtruth.txt", "frame": "body"}}),
}


def _write_odometry(folder: Path, robot: Source) -> None:
    stamps_ns = np.array([frame.stamp_ns for frame in robot.frames], dtype=np.int64)
    poses = np.array([frame.T_odom_body for frame in robot.frames])
    write_tum(folder / ODOMETRY, Trajectory(stamps_ns, poses), "T_odom_body")


def _write_png(path: Path, image: NDArray[np.uint8]) -> None:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    _, encoded = cv2.imencode(".png", grey)
    path.write_bytes(encoded.tobytes())


def _sensor_yaml(camera: Camera) -> str:
    kind, coefficients = _distortion(camera)
    rows = [", ".join(repr(value) for value in row) for row in camera.T_body_cam.tolist()]
    data = ",\n         ".join(rows)
    return (
        "sensor_type: camera\n"
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\n"
        f"resolution: [{camera.width}, {camera.height}]\n"
        "camera_model: pinhole\n"
        f"intrinsics: {camera.params[:4].tolist()}\n"
        f"distortion_model: {kind}\n"
        f"distortion_coefficients: {coefficients.tolist()}\n"
    )


def _distortion(camera: Camera) -> tuple[str, Array]:
    """The layout's name of a model, and its coefficients."""
    given = camera.params[4:]
    match camera.model:
        case "PINHOLE":
            return "none", given
        case "OPENCV":
            return "radial-tangential", given
        case "OPENCV_FISHEYE":
            return "equidistant", given
        case "FULL_OPENCV" if not given[5:].any():
            return "radial-tangential", given[:5]
    raise DatasetError(f"the ASL layout has no name for {camera.model} with such coefficients")


def _pose_csv(truth: Trajectory) -> str:
    lines = [
        "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
        "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    ]
    poses = frames.pose_from_transform(truth.T_ref_body)[:, [0, 1, 2, 6, 3, 4, 5]]
    for stamp_ns, pose in zip(truth.stamps_ns, poses.tolist(), strict=True):
        lines.append(",".join([str(stamp_ns), *map(repr, pose)]))
    return "\n".join([*lines, ""])
