"""The larger scenarios of the repository: ways that can be walked, past things that can be seen."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from covinz_agents.paths import given_positions_m, true_path
from covinz_agents.world.build import build_world
from covinz_agents.world.clearance import clearance_m, first_hit_m

from covinz.calibration import camera_of
from covinz.scenario import FileOdometry, RenderedAgent, Scenario, load_scenario
from covinz.trajectory import read_tum

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("COVINZ_DATA", ROOT.parent / "shared" / "data"))


def rendered(scenario: Scenario) -> list[RenderedAgent]:
    agents = [agent for agent in scenario.agents if isinstance(agent, RenderedAgent)]
    assert len(agents) == len(scenario.agents)
    return agents


def test_four_robots_walk_through_the_courtyard() -> None:
    scenario = load_scenario(ROOT / "scenarios" / "courtyard.yaml")
    assert scenario.scene is not None
    world = build_world(scenario.scene)
    lengths_m, depths_m = [], []
    for agent in rendered(scenario):
        poses = true_path(agent.path, world, 1.0, agent.id).T_ref_body
        positions = poses[:, :3, 3]
        lengths_m.append(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
        assert clearance_m(world, positions[::3]).min() > 0.8
        T_world_cam = poses @ camera_of(agent.camera, agent.id).T_body_cam
        depths_m.append(first_hit_m(world, T_world_cam[:, :3, 3], T_world_cam[:, :3, 2]))
    assert len(lengths_m) == 4
    assert sum(lengths_m) == pytest.approx(2400, rel=0.05)
    # They look at fronts near enough for the baseline of a few steps, and hardly into the far.
    depth_m = np.concatenate(depths_m)
    assert 5 < np.median(depth_m) < 12
    assert np.mean(depth_m < 25) > 0.8


def test_five_drones_fly_through_the_machine_hall() -> None:
    if not (DATA / "euroc_trajectories").is_dir():
        pytest.skip("needs the EuRoC trajectories below COVINZ_DATA")
    path = ROOT / "scenarios" / "machine_hall.yaml"
    scenario = load_scenario(path, {"COVINZ_DATA": str(DATA)})
    agents = rendered(scenario)
    flights_m = [given_positions_m(agent.path) for agent in agents]
    assert len(flights_m) == 5
    # The recordings' published camera is a rigid transform, to the digits that are given.
    for agent in agents:
        R = camera_of(agent.camera, agent.id).T_body_cam[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-8)
    assert scenario.scene is not None
    world = build_world(scenario.scene, np.concatenate(flights_m))
    for agent, flight_m in zip(agents, flights_m, strict=True):
        assert clearance_m(world, flight_m[::20]).min() >= 1.0 - 1e-6
        assert isinstance(agent.odometry, FileOdometry)
        # Most of the flight has an odometry pose.
        seconds = np.ptp(read_tum(agent.odometry.file).stamps_ns) * 1e-9
        assert seconds > 0.6 * len(flight_m) / 20
