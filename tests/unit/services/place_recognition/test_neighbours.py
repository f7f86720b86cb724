from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz import frames
from covinz.config import FastLoopConfig, OdometryNoise, RigConfig
from covinz.types import Array, Camera
from services.place_recognition import neighbours
from services.place_recognition.neighbours import Choice, Options, core_options

FAST = FastLoopConfig()
DEFAULT = core_options(RigConfig(), FAST)
# The body's x axis looks ahead, z is up.
AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
CAMERA = Camera(
    "OPENCV",
    640,
    480,
    np.array([460.0, 455.0, 318.0, 242.0, -0.25, 0.06, 2e-4, -1e-4]),
    frames.transform(AHEAD, [0.0, 0.0, 0.0]),
)


def poses(steps: list[tuple[list[float], list[float]]]) -> Array:
    """Keyframes by the steps between them: translation [m], rotation [rad]."""
    T = [np.eye(4)]
    for moved_m, turned_rad in steps:
        T.append(T[-1] @ frames.transform(frames.so3_exp(turned_rad), moved_m))
    return np.stack(T)


def straight(count: int, step: list[float]) -> Array:
    return poses([(step, [0.0, 0.0, 0.0])] * (count - 1))


def choose(
    T_odom_body: Array, cameras: list[Camera], reference: int, size: int, options: Options
) -> Choice:
    return neighbours.choose(list(T_odom_body), cameras, reference, size, options)


def others(T_odom_body: Array, reference: int, size: int, **rigs: Any) -> list[int]:
    """Rows besides the reference, as steps from it."""
    cameras = [CAMERA] * len(T_odom_body)
    choice = choose(T_odom_body, cameras, reference, size, core_options(RigConfig(**rigs), FAST))
    assert choice.rows[0] == reference
    assert len(set(choice.rows)) == len(choice.rows) == min(size, len(T_odom_body))
    assert list(choice.rows[1:]) == sorted(choice.rows[1:])
    return [row - reference for row in choice.rows[1:]]


def information(T_odom_body: Array, reference: int, size: int) -> float:
    cameras = [CAMERA] * len(T_odom_body)
    return choose(T_odom_body, cameras, reference, size, DEFAULT).information


def test_a_baseline_is_longer_than_a_step_and_shorter_than_the_view() -> None:
    T = straight(41, [0.0, 0.1, 0.0])
    (before,) = others(T[:21], 20, 2)
    assert 0.2 < -0.1 * before < 1.2
    one, two = others(T, 20, 3)
    assert -12 < one < -1 and 1 < two < 12


def test_sparse_keyframes_take_the_next_ones() -> None:
    assert others(straight(21, [0.0, 0.5, 0.0]), 10, 3) == [-1, 1]
    assert others(straight(11, [0.0, 0.5, 0.0]), 10, 2) == [-1]


def test_nearer_scenes_and_worse_odometry_make_shorter_rigs() -> None:
    T = straight(81, [0.0, 0.03, 0.0])
    near, far = (others(T, 40, 3, depth_m=depth_m)[1] for depth_m in (1.0, 4.0))
    assert near < far
    noise = OdometryNoise(rotation_per_sqrt_m=0.1, rotation_per_sqrt_rad=0.2)
    drifting = core_options(RigConfig(), FastLoopConfig(odometry=noise))
    worse = choose(T, [CAMERA] * 81, 40, 3, drifting)
    best = choose(T, [CAMERA] * 81, 40, 3, DEFAULT)
    assert max(worse.rows) <= max(best.rows)
    assert worse.information < best.information


def test_standing_still_is_passed_over() -> None:
    """Among many keyframes of one place, those that were elsewhere are found."""
    still = [([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])] * 12
    moved = [([0.0, 0.15, 0.0], [0.0, 0.0, 0.0])] * 4
    T = poses([*moved, *still, *moved])
    found = others(T, 10, 3)
    assert found[0] < -6 and found[1] > 6
    # In a rig of five, too.
    centres = T[[10 + step for step in others(T, 10, 5)], :3, 3]
    assert np.linalg.norm(centres - T[10, :3, 3], axis=1).min() > 0.1


def test_nothing_but_standing_still_gives_the_nearest() -> None:
    T = straight(21, [0.0, 0.0, 0.0])
    assert others(T, 10, 3) == [-1, 1]
    assert others(T, 20, 2) == [-1]
    assert information(T, 10, 3) == 0.0


def test_views_that_have_turned_away_are_left_out() -> None:
    """A corner: behind it there is a longer baseline, but nothing in common."""
    before = [([0.1, 0.0, 0.0], [0.0, 0.0, 0.0])] * 8
    corner = [([0.1, 0.0, 0.0], [0.0, 0.0, np.pi / 2])]
    after = [([0.1, 0.0, 0.0], [0.0, 0.0, 0.0])] * 3
    T = poses([*before, *corner, *after])
    rows = [11 + step for step in others(T, 11, 3)]
    assert min(rows) >= 9


def test_a_turn_on_the_spot_still_gives_a_rig_but_hardly_a_scale() -> None:
    T = poses([([0.0, 0.0, 0.0], [0.0, 0.0, 0.15])] * 20)
    found = others(T, 10, 3)
    assert all(abs(step) <= 3 for step in found)
    assert information(T, 10, 3) < RigConfig().min_information
    # Rolling about the optical axis leaves the view where it was, up to the corners.
    roll = poses([([0.02, 0.0, 0.0], [0.15, 0.0, 0.0])] * 20)
    assert information(roll, 10, 3) > RigConfig().min_information


def test_the_lever_arm_of_a_camera_is_a_baseline() -> None:
    T = poses([([0.0, 0.0, 0.0], [0.0, 0.0, 0.1])] * 20)
    arm = dataclasses.replace(CAMERA, T_body_cam=frames.transform(AHEAD, [0.5, 0.0, 0.0]))
    cameras = [arm] * len(T)
    choice = choose(T, cameras, 10, 3, DEFAULT)
    assert choice.information > RigConfig().min_information > information(T, 10, 3)


def test_information_is_that_of_the_scale() -> None:
    """Baseline over odometry's standard deviation, squared, as far as both see the same."""
    noise = OdometryNoise(rotation_per_sqrt_m=0.0, min_rotation=1e-9)
    T = straight(2, [0.0, 0.2, 0.0])
    # So far away that everything looks the same from both.
    distant = core_options(RigConfig(depth_m=1e4), FastLoopConfig(odometry=noise))
    choice = choose(T, [CAMERA] * 2, 0, 2, distant)
    variance = noise.translation_per_sqrt_m**2 * 0.2 + noise.min_translation**2
    assert choice.information == pytest.approx(0.2**2 / variance, rel=1e-3)
    assert information(T, 0, 2) < choice.information


@st.composite
def walks(draw: st.DrawFn) -> Array:
    """Up to 16 keyframes of some walk."""
    seed, count = draw(st.integers(0, 2**32 - 1)), draw(st.integers(1, 16))
    rng = np.random.default_rng(seed)
    step_m, turn_rad = draw(st.sampled_from([0.0, 0.02, 0.2])), draw(st.sampled_from([0.0, 0.1]))
    drawn = rng.normal(size=(count - 1, 2, 3)) * np.array([[step_m], [turn_rad]])
    return poses([(list(moved), list(turned)) for moved, turned in drawn])


@given(walks(), st.data())
def test_the_odometry_s_frame_does_not_matter(T_odom_body: Array, data: st.DataObject) -> None:
    reference = data.draw(st.integers(0, len(T_odom_body) - 1))
    size = data.draw(st.integers(2, 5))
    cameras = [CAMERA] * len(T_odom_body)
    T = frames.transform(frames.so3_exp([0.4, -1.0, 0.3]), [100.0, -40.0, 20.0])
    one = choose(T_odom_body, cameras, reference, size, DEFAULT)
    moved = choose(T @ T_odom_body, cameras, reference, size, DEFAULT)
    assert one.rows == moved.rows
    assert one.information == pytest.approx(moved.information, rel=1e-3, abs=1e-3)


@given(st.lists(st.floats(0.0, 0.5), max_size=12), st.data())
def test_no_other_rig_of_that_size_tells_more(steps_m: list[float], data: st.DataObject) -> None:
    # Along a line, so that leaving keyframes out does not change the path between the others.
    T = poses([([0.0, step_m, 0.0], [0.0, 0.0, 0.0]) for step_m in steps_m])
    reference = data.draw(st.integers(0, len(T) - 1))
    size = data.draw(st.integers(2, 5))
    rest = [row for row in range(len(T)) if row != reference]
    drawn = data.draw(st.permutations(rest))[: size - 1]
    rows = sorted([reference, *drawn])
    anywhere = core_options(RigConfig(min_overlap=0.0), FAST)
    best = choose(T, [CAMERA] * len(T), reference, size, anywhere)
    other = choose(T[rows], [CAMERA] * len(rows), rows.index(reference), size, anywhere)
    assert other.information <= best.information + 1e-3


def test_what_is_looked_at_ends_with_the_path_but_keeps_the_next_few() -> None:
    # Of a distant scene the longest baseline is best, however far it is.
    distant = {"depth_m": 1e4}
    T = straight(101, [0.0, 0.05, 0.0])
    assert others(T, 50, 3, max_path_m=1.01, **distant) == [-20, 20]
    assert others(T[:51], 50, 2, max_path_m=1.01, **distant) == [-20]
    assert others(T, 5, 3, max_path_m=1.01, **distant) == [-5, 20]
    assert others(T, 50, 3, max_path_m=0.0, **distant) == [-4, 4]
    assert others(T[:1], 0, 3) == []


def test_a_calibration_that_is_none_is_an_error() -> None:
    broken = dataclasses.replace(CAMERA, params=CAMERA.params[:3])
    with pytest.raises(ValueError, match="8 parameters"):
        choose(straight(3, [0.0, 0.1, 0.0]), [broken] * 3, 1, 3, DEFAULT)
