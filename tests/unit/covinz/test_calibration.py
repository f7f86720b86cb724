"""Calibration files become cameras, or an error that names the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from covinz.calibration import read_camera, read_T_body_cam
from covinz.config import ConfigError

SIZE = (640, 480)
IDENTITY = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
GOOD: dict[str, Any] = {
    "model": "OPENCV",
    "width": 640,
    "height": 480,
    "params": [514.3, 514.3, 311.7, 240.5, -0.063, 0.0, 0.0, 0.0],
    "T_body_cam": IDENTITY,
}


def written(tmp_path: Path, **changes: object) -> Path:
    path = tmp_path / "calib.yaml"
    path.write_text(yaml.safe_dump(GOOD | changes))
    return path


def test_calib_yaml(tmp_path: Path) -> None:
    turned = [0.0, 0, 1, 0.1, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 0, 1]
    camera = read_camera(written(tmp_path, T_body_cam=turned), SIZE)
    assert (camera.model, camera.width, camera.height) == ("OPENCV", 640, 480)
    assert camera.params.tolist() == GOOD["params"]
    assert camera.T_body_cam[0].tolist() == [0, 0, 1, 0.1]
    assert np.array_equal(read_T_body_cam(written(tmp_path)), np.eye(4))


def test_tum_calibration_is_full_opencv_with_the_third_radial_term_in_place(
    tmp_path: Path,
) -> None:
    path = tmp_path / "calib.txt"
    path.write_text("# fr1\n517.3 516.5 318.6 255.3 0.26 -0.95 -0.005 0.003 1.16\n")
    camera = read_camera(path, SIZE)
    assert camera.model == "FULL_OPENCV"
    assert camera.params.tolist() == [
        *(517.3, 516.5, 318.6, 255.3),
        *(0.26, -0.95, -0.005, 0.003),
        *(1.16, 0, 0, 0),
    ]
    assert np.array_equal(read_T_body_cam(path), np.eye(4))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 320}, "for 320 x 480 pixels, the images have 640 x 480"),
        ({"params": [1.0, 1.0, 0.0, 0.0]}, "OPENCV has 8 parameters"),
        ({"params": [float("nan")] * 8}, "finite"),
        ({"params": [-5.0, 5, 0, 0, 0, 0, 0, 0]}, "focal lengths positive"),
        ({"model": "RADIAL"}, "PINHOLE"),
        ({"T_body_cam": IDENTITY[:12]}, "16 numbers, got 12"),
        ({"T_body_cam": [2.0, *IDENTITY[1:]]}, "not a rigid transform"),
        ({"lens": "wide"}, "there is no such setting"),
    ],
)
def test_bad_entries_are_named(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        read_camera(written(tmp_path, **changes), SIZE)
    assert "calib.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected one line"),
        ("1 2 3 4\n", "expected one line"),
        ("1 2 3 4 5 6 7 8 9\n1 2 3 4 5 6 7 8 9\n", "expected one line"),
        ("# c\n1 2 3 4 5 6 7 8 x\n", "calib.txt:2: could not convert"),
        ("1 2 3 4 5 6 7 8 inf\n", "finite"),
    ],
)
def test_bad_tum_calibration_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_camera(path, SIZE)


@pytest.mark.parametrize("name", ["gone.yaml", "gone.txt"])
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=f"cannot read .*{name}"):
        read_camera(tmp_path / name, SIZE)
