"""Scenario files: variables, defaults, and errors that name file and entry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from covinz.config import ConfigError
from covinz.scenario import (
    DriftingGroundTruth,
    FileOdometry,
    RenderedAgent,
    Scenario,
    TumAgent,
    generated_groundtruth_file,
    groundtruth,
    load_scenario,
)
from covinz.trajectory import Trajectory, write_tum

SCENARIOS = Path(__file__).resolve().parents[3] / "scenarios"

RECORDED = """
name: test
defaults:
  reader: tum
  path: ${ROOT:-/data}/kitchen
  odometry: {source: file, file: odometry.tum, frame: camera}
  keyframes: {translation_m: 0.08}
agents:
  - {id: a0, frames: [0, 9]}
  - {id: a1, times_s: ["1.5", "2.000000001"], keyframes: {rotation_rad: 0.3}}
"""

RENDERED = """
name: generated
scene: {kind: hall}
agents:
  - {id: r0, reader: rendered, path: {kind: waypoints, points_m: [[0, 0, 1], [1, 0, 1], [1, 1, 1]]}}
"""


def load(tmp_path: Path, text: str, environ: dict[str, str] | None = None) -> Scenario:
    path = tmp_path / "test.yaml"
    path.write_text(text)
    return load_scenario(path, environ or {})


def recorded(scenario: Scenario) -> list[TumAgent]:
    return [agent for agent in scenario.agents if isinstance(agent, TumAgent)]


def test_variables_are_replaced_or_take_their_default(tmp_path: Path) -> None:
    assert recorded(load(tmp_path, RECORDED))[0].path == Path("/data/kitchen")
    assert recorded(load(tmp_path, RECORDED, {"ROOT": ""}))[0].path == Path("/data/kitchen")
    assert recorded(load(tmp_path, RECORDED, {"ROOT": "/x y"}))[0].path == Path("/x y/kitchen")


def test_a_variable_without_value_or_default_is_an_error(tmp_path: Path) -> None:
    text = RECORDED.replace("${ROOT:-/data}", "${NOT_SET_ANYWHERE}")
    with pytest.raises(ConfigError, match="variable NOT_SET_ANYWHERE is not set"):
        load(tmp_path, text)


def test_an_agent_takes_what_it_does_not_say_from_the_defaults(tmp_path: Path) -> None:
    first, second = recorded(load(tmp_path, RECORDED))
    assert (first.keyframes.translation_m, first.keyframes.rotation_rad) == (0.08, 0.15)
    assert (second.keyframes.translation_m, second.keyframes.rotation_rad) == (0.08, 0.3)
    assert isinstance(first.odometry, FileOdometry)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("id: a1", "id: a0", "same id"),
        ("id: a1", "id: A1", "String should match pattern"),
        ("reader: tum", "reader: bag", "does not match any of the expected tags"),
        ("frames: [0, 9]", "frames: [9, 0]", "the first frame comes after the last"),
        ("frames: [0, 9]", "frames: [0, -1]", "greater than or equal to 0"),
        ('["1.5", "2.000000001"]', '["2.5", "2"]', "the first time comes after the last"),
        ('["1.5", "2.000000001"]', '["x", "2"]', "not a time stamp"),
        ("frames: [0, 9]", 'frames: [0, 9], times_s: ["1", "2"]', "frames or times_s, not both"),
        ("frame: camera", "frame: imu", "body"),
        ("source: file, file: odometry.tum, frame: camera", "source: guess", "expected tags"),
        (
            "source: file, file: odometry.tum, frame: camera",
            "source: groundtruth_drift",
            "needs groundtruth",
        ),
        ("translation_m: 0.08", "translation_m: 0", "greater than 0"),
        ("translation_m: 0.08", "translatoin_m: 0.1", "there is no such setting"),
        ("name: test", "name: test\nspeed: 3", "there is no such setting"),
        ("name: test", "name: ''", "at least 1 character"),
        ("name: test", "name: test\nconfig: {optimizer: {q: 4}}", "there is no such setting"),
    ],
)
def test_bad_entries_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in RECORDED
    with pytest.raises(ConfigError, match=message) as caught:
        load(tmp_path, RECORDED.replace(old, new))
    assert "test.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("scene: {kind: hall}", "seed: 1", "r0 is rendered: give the scene it is in"),
        ("scene: {kind: hall}", "scene: {kind: moon}", "does not match any of the expected tags"),
        ("kind: waypoints", "kind: straight", "does not match any of the expected tags"),
        ("kind: waypoints", "kind: waypoints, laps: 2", "laps are for closed paths"),
        ("[1, 0, 1], [1, 1, 1]", "[1, 0, 1], [1, 0, 1]", "neighbouring points are the same"),
        (
            "[1, 1, 1]]",
            "[0, 0, 1]], closed: true",
            "neighbouring points are the same",
        ),
        (
            "kind: waypoints, points_m: [[0, 0, 1], [1, 0, 1], [1, 1, 1]]",
            'kind: file, file: x.tum, times_s: ["2", "1"]',
            "the first time comes after the last",
        ),
    ],
)
def test_bad_entries_of_rendered_robots_are_named(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in RENDERED
    load(tmp_path, RENDERED)
    with pytest.raises(ConfigError, match=message):
        load(tmp_path, RENDERED.replace(old, new))


def test_a_scenario_without_agents_is_an_error(tmp_path: Path) -> None:
    for text in ("name: x", "name: x\nagents: []", "name: x\nagents: [1]", "- 1"):
        with pytest.raises(ConfigError):
            load(tmp_path, text)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cannot read .*gone\.yaml"):
        load_scenario(tmp_path / "gone.yaml")


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_scenarios_of_the_repository_load(path: Path) -> None:
    assert load_scenario(path, {}).name == path.stem


def test_redkitchen_is_three_disjoint_thirds_with_real_odometry() -> None:
    agents = recorded(load_scenario(SCENARIOS / "redkitchen.yaml", {}))
    assert [agent.frames for agent in agents] == [(0, 332), (334, 666), (668, 998)]
    for agent in agents:
        assert agent.path == Path("../shared/data/redkitchen")
        assert agent.odometry == FileOdometry(
            source="file", file=Path("odometry.tum"), frame="camera"
        )
        assert (agent.keyframes.translation_m, agent.keyframes.rotation_rad) == (0.08, 0.08)


def test_other_scenarios_have_what_their_kind_needs() -> None:
    for agent in recorded(load_scenario(SCENARIOS / "fr1_rpy.yaml", {})):
        assert isinstance(agent.odometry, DriftingGroundTruth)
    hall = load_scenario(SCENARIOS / "hall.yaml", {})
    assert all(isinstance(agent, RenderedAgent) for agent in hall.agents)
    assert len(hall.agents) == 3
    looks = [agent.look for agent in hall.agents if isinstance(agent, RenderedAgent)]
    assert len({look.light for look in looks}) == 3


def test_groundtruth_of_a_camera_becomes_that_of_the_body(tmp_path: Path) -> None:
    T_body_cam = np.eye(4)
    T_body_cam[:3, 3] = [0.0, 0.0, 0.5]
    camera = {"model": "PINHOLE", "width": 4, "height": 3, "params": [1.0, 1.0, 0.0, 0.0]}
    camera["T_body_cam"] = T_body_cam.ravel().tolist()
    (tmp_path / "calib.yaml").write_text(yaml.safe_dump(camera))
    T_world_cam = np.eye(4)
    T_world_cam[:3, 3] = [1.0, 2.0, 3.0]
    write_tum(tmp_path / "truth.tum", Trajectory(np.array([5]), T_world_cam[None]))
    text = RECORDED.replace(
        "  keyframes:", "  groundtruth: {file: truth.tum, frame: FRAME}\n  keyframes:"
    ).replace("${ROOT:-/data}/kitchen", str(tmp_path))
    for frame, z in (("camera", 2.5), ("body", 3.0)):
        read = groundtruth(load(tmp_path, text.replace("FRAME", frame)), "a0", tmp_path)
        assert read is not None
        assert read.T_ref_body[0, :3, 3].tolist() == [1.0, 2.0, z]
    assert groundtruth(load(tmp_path, RECORDED), "a0", tmp_path) is None


def test_groundtruth_of_a_rendered_agent_is_what_the_player_left(tmp_path: Path) -> None:
    scenario = load(tmp_path, RENDERED)
    left = Trajectory(np.array([7]), np.eye(4)[None])
    write_tum(generated_groundtruth_file("r0", tmp_path), left)
    read = groundtruth(scenario, "r0", tmp_path)
    assert read is not None
    assert read.stamps_ns.tolist() == [7]
