"""Calibrations of real cameras are fine; common mistakes are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from covinz.plausibility import ADVICE, complaints
from covinz.types import Camera

# Published calibrations: TUM RGB-D freiburg1, EuRoC cam0, TUM VI cam0 (512 x 512, 195 degrees).
TUM = Camera(
    "FULL_OPENCV",
    640,
    480,
    np.array([517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633, 0, 0, 0]),
    np.eye(4),
)
EUROC = Camera(
    "OPENCV",
    752,
    480,
    np.array([458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 0.00019359, 1.76e-05]),
    np.eye(4),
)
FISHEYE = Camera(
    "OPENCV_FISHEYE",
    512,
    512,
    np.array([190.98, 190.97, 254.93, 256.90, 0.0034823, 0.00071504, -0.0020532, 0.00020293]),
    np.eye(4),
)
PINHOLE = Camera("PINHOLE", 640, 480, np.array([500.0, 500.0, 319.5, 239.5]), np.eye(4))


def codes(camera: Camera) -> list[str]:
    found = list(complaints(camera))
    assert all(one.seen and one.advice == ADVICE[one.code] for one in found)
    return [one.code for one in found]


def changed(camera: Camera, **params: float) -> Camera:
    values = camera.params.copy()
    for name, value in params.items():
        values[int(name.removeprefix("p"))] = value
    return replace(camera, params=values)


@pytest.mark.parametrize("camera", [TUM, EUROC, FISHEYE, PINHOLE])
def test_real_cameras_are_plausible(camera: Camera) -> None:
    assert codes(camera) == []


@pytest.mark.parametrize(
    ("camera", "code"),
    [
        (changed(PINHOLE, p0=3.5, p1=3.5), "focal_length"),
        (changed(PINHOLE, p0=50000.0, p1=50000.0), "focal_length"),
        (changed(PINHOLE, p1=320.0), "aspect"),
        (changed(PINHOLE, p2=639.0), "principal_point"),
        (replace(EUROC, width=1504, height=960), "principal_point"),
        (changed(EUROC, p4=-0.8, p5=0.0), "distortion"),
        (changed(TUM, p8=-1.1633), "distortion"),
        (changed(FISHEYE, p6=-0.9), "distortion"),
    ],
)
def test_common_mistakes_are_named(camera: Camera, code: str) -> None:
    assert code in codes(camera)


def test_the_place_of_the_camera_is_looked_at() -> None:
    far, mirrored = np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0])
    far[0, 3] = 120.0  # millimetres
    assert codes(replace(PINHOLE, T_body_cam=far)) == ["lever"]
    assert codes(replace(PINHOLE, T_body_cam=mirrored)) == ["rotation"]
