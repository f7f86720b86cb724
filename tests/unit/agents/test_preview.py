"""The contact sheet: a row for each robot, an image for each column, clear errors."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from covinz_agents.preview import contact_sheet, main

from covinz.scenario import load_scenario
from tests.small_world import CAMERA, SCENE, arc

WIDTH_PX, GAP_PX = 80, 4


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    path = tmp_path / "two.yaml"
    agents = [{"id": "a0"}, {"id": "a1", "look": {"light": 1}}]
    defaults = {"reader": "rendered", "camera": CAMERA, "path": arc(0.0, 1.0)}
    path.write_text(
        yaml.safe_dump({"name": "two", "scene": SCENE, "defaults": defaults, "agents": agents})
    )
    return path


@pytest.mark.slow
def test_robots_are_rows_and_their_images_columns(scenario_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "sheet.png"
    command = [str(scenario_file), "--out", str(out), "--columns", "3", "--width", str(WIDTH_PX)]
    assert main(command) == 0
    sheet = cv2.imread(str(out))
    assert sheet is not None
    assert np.array_equal(sheet, contact_sheet(load_scenario(scenario_file), 3, WIDTH_PX))
    height_px = WIDTH_PX * 3 // 4
    assert sheet.shape == (2 * height_px + GAP_PX, 3 * WIDTH_PX + 2 * GAP_PX, 3)
    assert (sheet[height_px : height_px + GAP_PX] == 255).all()
    first, second = sheet[:height_px, :WIDTH_PX], sheet[height_px + GAP_PX :, :WIDTH_PX]
    assert min(first.std(), second.std()) > 10
    assert np.mean(np.abs(first.astype(float) - second)) > 3


@pytest.mark.parametrize(
    "name", ["missing.yaml", pytest.param("sheet.nothing", marks=pytest.mark.slow)]
)
def test_what_cannot_be_used_is_said(scenario_file: Path, tmp_path: Path, name: str) -> None:
    scenario = tmp_path / name if name.endswith("yaml") else scenario_file
    out = tmp_path / (name if not name.endswith("yaml") else "sheet.png")
    assert main([str(scenario), "--out", str(out), "--columns", "1", "--width", "40"]) == 2
    assert not out.exists()
