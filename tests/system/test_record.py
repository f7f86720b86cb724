"""Robots' images as data sets: written by the command, played by the player, the same log."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from covinz_agents.layouts import write_tum_layout

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


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        ("name: x\nagents: [{id: s0, reader: simulated}]\n", "reader simulated has no images"),
        ("name: x\nagents: []\n", "room.yaml"),
    ],
)
def test_what_cannot_be_recorded_is_explained(tmp_path: Path, scenario: str, message: str) -> None:
    (tmp_path / "room.yaml").write_text(scenario)
    out = tmp_path / "out"
    code, messages = python("covinz_agents.record", str(tmp_path / "room.yaml"), "--out", str(out))
    assert code == 2
    assert message in messages
    assert "Traceback" not in messages


def test_a_folder_with_something_in_it_is_left_alone(tmp_path: Path) -> None:
    path = scenario_file(tmp_path)
    code, messages = python("covinz_agents.record", str(path), "--out", str(tmp_path))
    assert code == 2
    assert f"{tmp_path} is not empty" in messages
