"""Robots' images as data sets: written by the command, played by the player, the same log."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from covinz_agents.layouts import write_tum_layout
from covinz_agents.staging import open_source

from covinz import codec
from covinz.scenario import load_scenario
from covinz.types import Keyframe, LogView
from tests.processes import CHECKOUT, PATIENCE_S, Processes
from tests.recordings import RoomRobot


def python(module: str, *arguments: str) -> tuple[int, str]:
    """Exit code and messages of a command."""
    argv = [sys.executable, "-m", module, *arguments]
    ended = subprocess.run(argv, cwd=CHECKOUT, capture_output=True, text=True, timeout=PATIENCE_S)
    return ended.returncode, ended.stderr


def scenario_file(folder: Path) -> Path:
    """A scenario of two recorded robots, one with half the features."""
    for name, model, start_rad in (("a", "OPENCV", 0.0), ("b", "OPENCV_FISHEYE", 0.5)):
        write_tum_layout(folder / name, RoomRobot(model, start_rad=start_rad))
    scenario: dict[str, Any] = {
        "name": "room",
        "config": {"place_recognition": {"num_candidates": 2}},
        "defaults": {
            "reader": "tum",
            "odometry": {"source": "file", "file": "odometry.tum", "frame": "body"},
            "keyframes": {"translation_m": 0.2, "rotation_rad": 0.2},
        },
        "agents": [
            {
                "id": "a",
                "path": str(folder / "a"),
                "groundtruth": {"file": "groundtruth.txt", "frame": "body"},
            },
            {"id": "b", "path": str(folder / "b"), "features": {"num_features": 300}},
        ],
    }
    path = folder / "room.yaml"
    path.write_text(yaml.safe_dump(scenario))
    return path


def log_of(scenario: Path, folder: Path) -> list[bytes]:
    """The log that a lockstep run leaves on a fresh server."""
    folder.mkdir()
    with Processes(folder) as server:
        server.start("router", "ingest")
        options = ["--endpoint", server.endpoint, "--spool", str(folder / "spool"), "--no-progress"]
        played = python("covinz_agents.play", str(scenario), *options, "--lockstep")
        assert played == (0, "")
        items = [entry.item for entry in server.log_entries(LogView.FULL)]
    return [codec.encode(item) for item in items if isinstance(item, Keyframe)]


def test_what_was_recorded_plays_like_the_original_in_every_layout(tmp_path: Path) -> None:
    """Poses start at the identity in the files, so that nothing is rounded twice."""
    original = scenario_file(tmp_path)
    expected = log_of(original, tmp_path / "original")
    assert len(expected) == 8
    source = load_scenario(original)
    for layout in ("asl", "tum"):
        out = tmp_path / layout
        written = python(
            "covinz_agents.record", str(original), "--out", str(out), "--layout", layout
        )
        assert written[0] == 0, written[1]
        assert log_of(out / "scenario.yaml", tmp_path / f"{layout}-log") == expected
        played = load_scenario(out / "scenario.yaml")
        assert played.config == source.config
        assert [agent.features for agent in played.agents] == [a.features for a in source.agents]


LENS = {
    "model": "OPENCV_FISHEYE",
    "width": 320,
    "height": 240,
    "params": [150.1, 150.2, 160.2, 119.1, 3.4e-3, 7e-4, -2e-3, 2e-4],
    "T_body_cam": [0, 0, 1, 0.1, -1, 0, 0, 0.03, 0, -1, 0, 0.05, 0, 0, 0, 1],
}
RENDERED = {
    "name": "rendered",
    "seed": 2,
    "scene": {"kind": "hall"},
    "agents": [
        {
            "id": "a",
            "reader": "rendered",
            "camera": LENS,
            "path": {"kind": "smooth", "length_m": 3.0},
            "frame_rate_hz": 2.0,
        }
    ],
}


@pytest.mark.slow
def test_every_layout_holds_what_a_rendered_robot_saw(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COVINZ_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "rendered.yaml"
    path.write_text(yaml.safe_dump(RENDERED))
    scenario = load_scenario(path)
    robot = open_source(scenario.agents[0], scenario)
    for layout in ("asl", "tum"):
        out = tmp_path / layout
        options = ["--out", str(out), "--layout", layout]
        code, messages = python("covinz_agents.record", str(path), *options)
        assert code == 0, messages
        written = load_scenario(out / "scenario.yaml")
        recording = open_source(written.agents[0], written)
        assert recording.camera.hash == robot.camera.hash
        assert recording.groundtruth is not None
        assert robot.groundtruth is not None
        truth = recording.groundtruth.T_ref_body
        assert np.allclose(truth, robot.groundtruth.T_ref_body, atol=3e-9)
        assert len(recording.frames) == len(robot.frames) == 8
        for read, original in zip(recording.frames, robot.frames, strict=True):
            assert read.stamp_ns == original.stamp_ns
            assert np.allclose(read.T_odom_body, original.T_odom_body, atol=1e-8)
            found, expected = recording.features(read), robot.features(original)
            assert len(expected) > 100
            assert found.keypoints_px.tobytes() == expected.keypoints_px.tobytes()
            assert found.descriptors.tobytes() == expected.descriptors.tobytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda scenario: scenario.update(agents=[]), "room.yaml"),
        (lambda scenario: scenario["agents"][0].update(images="gone.txt"), "gone.txt"),
        (lambda scenario: scenario["agents"][0].update(camera="gone.yaml"), "gone.yaml"),
    ],
)
def test_what_cannot_be_recorded_is_explained(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    path = scenario_file(tmp_path)
    scenario = yaml.safe_load(path.read_text())
    change(scenario)
    path.write_text(yaml.safe_dump(scenario))
    out = tmp_path / "out"
    code, messages = python("covinz_agents.record", str(path), "--out", str(out))
    assert code == 2
    assert message in messages
    assert "Traceback" not in messages


def test_a_folder_with_something_in_it_is_left_alone(tmp_path: Path) -> None:
    path = scenario_file(tmp_path)
    code, messages = python("covinz_agents.record", str(path), "--out", str(tmp_path))
    assert code == 2
    assert f"{tmp_path} is not empty" in messages
