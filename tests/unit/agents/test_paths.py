"""Paths of rendered robots: smooth, at the stated speed, away from everything, seeded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from covinz_agents.paths import START_NS, given_positions_m, true_path
from covinz_agents.wander import NoFreePath
from covinz_agents.world.builders import box, column
from covinz_agents.world.clearance import clearance_m, first_hit_m
from covinz_agents.world.geometry import World

from covinz import frames
from covinz.config import ConfigError
from covinz.scenario import FilePath, SmoothPath, WaypointPath
from covinz.trajectory import Trajectory, TrajectoryError, write_tum
from covinz.types import Array

RATE_HZ = 10.0
SMOOTH = SmoothPath(kind="smooth", length_m=30.0, height_m=(1.2, 2.0), speed_m_s=0.8)
CIRCLE = [(3 * np.cos(a), 3 * np.sin(a), 1.5) for a in np.arange(12) * np.pi / 6]


def room(size_m: float = 12.0) -> World:
    """A pillar and a box in a space whose walls are not drawn."""
    half = size_m / 2
    faces = (
        *column((1.0, 0.5, 0.0), 0.3, 4.0, "concrete"),
        *box((-3, -2, 0), (1, 1, 2), "concrete"),
    )
    return World(faces, np.array([-half, -half, 0.3]), np.array([half, half, 3.0]), False, 0)


def circle(**changes: object) -> WaypointPath:
    values = {"kind": "waypoints", "points_m": CIRCLE, "closed": True, "speed_m_s": 1.0}
    return WaypointPath.model_validate({**values, **changes})


def positions(path: Trajectory) -> Array:
    return path.T_ref_body[:, :3, 3]


def steps_m(path: Trajectory) -> Array:
    """Lengths in the plane: robots sway up and down."""
    return np.asarray(np.linalg.norm(np.diff(positions(path)[:, :2], axis=0), axis=1))


def test_a_smooth_path_keeps_its_distance_and_its_camera_sees_nothing_nearer() -> None:
    world = room()
    for agent in ("a0", "a1", "a2"):
        path = true_path(SMOOTH, world, RATE_HZ, agent)
        assert clearance_m(world, positions(path)).min() >= SMOOTH.min_depth_m
        ahead = path.T_ref_body[:, :3, 0]
        assert first_hit_m(world, positions(path), ahead).min() >= SMOOTH.min_depth_m
        assert np.all(np.abs(positions(path)[:, :2]) <= 6.0)


def test_a_smooth_path_has_the_length_speed_and_height_asked_for() -> None:
    path = true_path(SMOOTH, room(), RATE_HZ, "a0")
    assert np.all(np.diff(path.stamps_ns) == 100_000_000)
    assert path.stamps_ns[0] == START_NS
    assert len(path) == pytest.approx(30.0 / 0.8 * RATE_HZ, abs=2)
    assert steps_m(path).max() < 0.081
    # It climbs a little on the way.
    assert steps_m(path).sum() == pytest.approx(30.0, rel=0.02)
    heights = positions(path)[:, 2]
    assert 1.14 < heights.min() < 1.3
    assert 1.9 < heights.max() < 2.06


def test_a_smooth_path_turns_slowly_and_stays_level() -> None:
    path = true_path(SMOOTH, room(), RATE_HZ, "a0")
    turns = frames.rotation_angle(frames.inverse(path.T_ref_body[:-1]) @ path.T_ref_body[1:])
    # At most the tightest arc, 0.8 m/s on a radius of 1.5 m, and the sway.
    assert turns.max() < 0.1 * (0.8 / 1.5) + 0.015
    assert path.T_ref_body[:, 2, 2].min() > 0.99
    # The same arc takes 4.3 mm per frame and frame, the heave of the body 6.8 mm.
    second = np.diff(positions(path), n=2, axis=0)
    assert np.linalg.norm(second, axis=1).max() < 0.01


def test_the_same_seed_goes_the_same_way_and_others_do_not() -> None:
    first, same = (true_path(SMOOTH, room(), RATE_HZ, "a0", seed=2) for _ in range(2))
    assert first.T_ref_body.tobytes() == same.T_ref_body.tobytes()
    for agent, seed in (("a1", 2), ("a0", 3)):
        other = true_path(SMOOTH, room(), RATE_HZ, agent, seed)
        assert not np.allclose(positions(other)[:100], positions(first)[:100], atol=0.1)


@pytest.mark.parametrize(("size_m", "min_depth_m"), [(2.0, 1.0), (12.0, 9.0)])
def test_a_world_without_room_is_an_error(size_m: float, min_depth_m: float) -> None:
    path = SMOOTH.model_copy(update={"min_depth_m": min_depth_m})
    with pytest.raises(NoFreePath):
        true_path(path, room(size_m), RATE_HZ, "a0")


def test_waypoints_on_a_circle_make_a_circle() -> None:
    path = true_path(circle(), room(), RATE_HZ, "a0")
    radius = np.linalg.norm(positions(path)[:, :2], axis=1)
    assert np.abs(radius - 3.0).max() < 0.005
    assert len(path) == pytest.approx(2 * np.pi * 3 * RATE_HZ, abs=3)
    assert np.abs(steps_m(path) - 0.1).max() < 0.002
    # x of the body is ahead.
    ahead = np.diff(positions(path)[:, :2], axis=0)
    gaze = path.T_ref_body[:-1, :2, 0]
    inner = slice(30, -30)
    assert np.all(np.sum(ahead * gaze, axis=1)[inner] > 0.098)
    left = true_path(circle(look_rad=np.pi / 2), room(), RATE_HZ, "a0").T_ref_body[:, :2, 0]
    to_middle = -positions(path)[:, :2] / 3.0
    assert np.all(np.sum(left * to_middle, axis=1)[inner] > 0.99)


def test_laps_go_on_where_the_path_began() -> None:
    once = true_path(circle(), room(), RATE_HZ, "a0")
    twice = true_path(circle(laps=2.5), room(), RATE_HZ, "a0")
    assert len(twice) == pytest.approx(2.5 * len(once), abs=4)
    assert np.linalg.norm(np.diff(positions(twice)[:, :2], axis=0), axis=1).max() < 0.102
    assert np.allclose(np.linalg.norm(positions(twice)[:, :2], axis=1), 3.0, atol=0.005)


def test_an_open_path_goes_through_its_points_from_the_first_to_the_last() -> None:
    points = [(0.0, 0.0, 1.0), (2.0, 1.0, 1.5), (3.0, 3.0, 1.0)]
    spec = WaypointPath.model_validate(
        {"kind": "waypoints", "points_m": points, "speed_m_s": 0.1, "start_s": 3.0}
    )
    path = true_path(spec, room(), 50.0, "a0")
    assert path.stamps_ns[0] == START_NS + 3_000_000_000
    for point in points:
        distance = np.linalg.norm(positions(path)[:, :2] - point[:2], axis=1)
        assert distance.min() < 0.01
    assert np.allclose(positions(path)[0, :2], points[0][:2])
    straight = WaypointPath.model_validate(
        {"kind": "waypoints", "points_m": [(0, 0, 1), (4, 0, 1)]}
    )
    assert np.abs(positions(true_path(straight, room(), RATE_HZ, "a0"))[:, 1]).max() < 1e-9
    assert np.allclose(given_positions_m(straight)[[0, -1]], [(0, 0, 1), (4, 0, 1)])


def flight(tmp_path: Path) -> Path:
    """Positions x = t at 20 Hz for 3 s, from 100 s on; nothing between 101 and 102 s."""
    seconds = np.array([t for t in np.arange(61) / 20 if not 1.0 < t < 2.0])
    stamps = 100_000_000_000 + np.rint(seconds * 1e9).astype(np.int64)
    poses = frames.transform(np.eye(3), seconds[:, None] * [1.0, 0.0, 0.0])
    write_tum(tmp_path / "flight.tum", Trajectory(stamps, poses))
    return tmp_path / "flight.tum"


def test_a_flight_is_sampled_at_the_frame_rate_without_its_gaps(tmp_path: Path) -> None:
    spec = FilePath(kind="file", file=flight(tmp_path))
    path = true_path(spec, room(), 8.0, "a0")
    seconds = (path.stamps_ns - 100_000_000_000) * 1e-9
    assert np.allclose(seconds, [t for t in np.arange(25) / 8 if not 1.0 < t < 2.0])
    assert np.allclose(positions(path)[:, 0], seconds)
    assert len(given_positions_m(spec)) == 42
    part = FilePath(kind="file", file=spec.file, times_s=("100.5", "101"))
    assert len(true_path(part, room(), 8.0, "a0")) == 5


def test_a_flight_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="gone"):
        true_path(FilePath(kind="file", file=tmp_path / "gone.tum"), room(), 8.0, "a0")
    early = FilePath(kind="file", file=flight(tmp_path), times_s=("1", "2"))
    with pytest.raises(ConfigError, match="no pose in the range"):
        true_path(early, room(), 8.0, "a0")
    with pytest.raises(ConfigError, match="no pose in the range"):
        given_positions_m(early)
