"""Drift is seeded, starts at the origin and has the stated size at any frame rate."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.drift import drifting_odometry

from covinz import frames
from covinz.scenario import Drift
from covinz.types import Array

NONE = Drift(
    rotation_per_sqrt_m=0,
    rotation_per_sqrt_rad=0,
    translation_per_sqrt_m=0,
    translation_per_sqrt_rad=0,
)


def straight(num_steps: int, length_m: float = 4.0) -> Array:
    x = np.linspace(2.0, 2.0 + length_m, num_steps + 1)
    return frames.transform(np.eye(3), x[:, None] * [1.0, 0.0, 0.0])


def test_without_drift_it_is_the_truth_seen_from_the_first_pose() -> None:
    path = straight(10) @ frames.transform(frames.so3_exp([0.1, 0.2, 0.3]), [0.0, 1.0, 0.0])
    odometry = drifting_odometry(path, NONE, "a0")
    assert np.array_equal(odometry[0], np.eye(4))
    assert np.allclose(odometry, frames.inverse(path[0]) @ path)


def test_the_same_seed_and_robot_drift_the_same_and_others_do_not() -> None:
    path = straight(10)
    first, same = (drifting_odometry(path, Drift(seed=3), "a0") for _ in range(2))
    assert first.tobytes() == same.tobytes()
    for other in (
        drifting_odometry(path, Drift(seed=4), "a0"),
        drifting_odometry(path, Drift(seed=3), "a1"),
    ):
        assert not np.allclose(first, other, atol=1e-4)


@pytest.mark.parametrize("num_steps", [1, 16])
def test_the_sigma_after_four_metres_is_twice_that_after_one(num_steps: int) -> None:
    only_rotation = NONE.model_copy(update={"rotation_per_sqrt_m": 0.01})
    only_translation = NONE.model_copy(update={"translation_per_sqrt_m": 0.03})
    path = straight(num_steps)
    turned, moved = [], []
    for seed in range(400):
        end = drifting_odometry(path, only_rotation.model_copy(update={"seed": seed}), "a")[-1]
        turned.append(frames.so3_log(end[:3, :3]))
        end = drifting_odometry(path, only_translation.model_copy(update={"seed": seed}), "a")[-1]
        moved.append(end[:3, 3] - [4.0, 0, 0])
    assert np.std(turned) == pytest.approx(0.02, rel=0.1)
    assert np.std(moved) == pytest.approx(0.06, rel=0.1)


def test_a_robot_that_stands_still_does_not_drift() -> None:
    still = np.tile(np.eye(4), (5, 1, 1))
    assert np.array_equal(drifting_odometry(still, Drift(), "a0"), still)


def test_no_poses_give_no_odometry() -> None:
    assert drifting_odometry(np.empty((0, 4, 4)), Drift(), "a0").shape == (0, 4, 4)
