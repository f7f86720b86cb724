"""A keyframe is due by motion since the last keyframe, not since the last frame."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.selection import KeyframeSelector, select_keyframes
from covinz_agents.source import Frame

from covinz import frames
from covinz.config import KeyframeSelectionConfig
from covinz.types import Array

CONFIG = KeyframeSelectionConfig(translation_m=0.15, rotation_rad=0.15)


def pose(x_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
    return frames.transform(frames.so3_exp([0.0, 0.0, yaw_rad]), [x_m, 0.0, 0.0])


def test_the_first_frame_is_due_wherever_it_is() -> None:
    assert KeyframeSelector(CONFIG).is_due(pose(12.0, 1.0))


@pytest.mark.parametrize(
    ("T", "due"),
    [
        (pose(0.149), False),
        (pose(0.151), True),
        (pose(0.0, 0.149), False),
        (pose(0.0, 0.151), True),
        (pose(0.0, -0.151), True),
        (pose(0.1, 0.1), False),
    ],
)
def test_either_threshold_is_enough(T: Array, due: bool) -> None:
    selector = KeyframeSelector(CONFIG)
    selector.is_due(pose())
    assert selector.is_due(T) is due


def test_motion_adds_up_since_the_last_keyframe() -> None:
    steps = [Frame(i, i, pose(0.04 * i)) for i in range(13)]
    assert [frame.number for frame in select_keyframes(steps, CONFIG)] == [0, 4, 8, 12]


def test_a_robot_that_comes_back_has_not_moved() -> None:
    there_and_back = [0.0, 0.1, 0.0, -0.1, 0.0]
    steps = [Frame(i, i, pose(x)) for i, x in enumerate(there_and_back)]
    assert len(select_keyframes(steps, CONFIG)) == 1


def test_selection_does_not_depend_on_the_odometry_frame() -> None:
    rng = np.random.default_rng(4)
    path = [pose(0.06 * i, 0.03 * i) for i in range(40)]
    T_other_odom = frames.transform(frames.so3_exp(rng.normal(size=3)), rng.normal(size=3))
    first, second = (
        select_keyframes([Frame(i, i, T) for i, T in enumerate(poses)], CONFIG)
        for poses in (path, [T_other_odom @ T for T in path])
    )
    assert [frame.number for frame in first] == [frame.number for frame in second]
    assert len(first) > 10
