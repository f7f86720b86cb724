"""Drift is seeded, starts at the origin and has the stated size at any frame rate."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from covinz_agents.drift import drifting_odometry, keyframe_covariances

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


@pytest.mark.parametrize("drift", [Drift(), Drift(rotation_per_sqrt_m=0.01)])
def test_the_covariance_that_a_robot_states_is_the_truth(drift: Drift) -> None:
    """Errors of the motion between keyframes, whitened by the stated covariance, are normal."""
    rng = np.random.default_rng(4)
    turns = frames.so3_exp(rng.normal(size=(40, 3)) * 0.03)
    truth = [np.eye(4)]
    for R in turns:
        truth.append(truth[-1] @ frames.transform(R, [0.08, 0.01, 0.0]))
    path, keyframes = np.array(truth), [0, 6, 20, 40]
    whitened = []
    for seed in range(1500):
        odometry = drifting_odometry(path, drift, "a0", seed)
        stated = keyframe_covariances(odometry, keyframes, drift)
        assert stated[0] is None
        for (i, j), covariance in zip(itertools.pairwise(keyframes), stated[1:], strict=True):
            true, measured = (frames.inverse(T[i]) @ T[j] for T in (path, odometry))
            error = frames.local_error(true, measured)
            assert covariance is not None
            whitened.append(np.linalg.solve(np.linalg.cholesky(covariance), error))
    for errors in np.reshape(whitened, (1500, 3, 6)).transpose(1, 2, 0):
        np.testing.assert_allclose(np.cov(errors), np.eye(6), atol=0.12)
        # Mean normalised estimation error squared: 6 degrees of freedom.
        assert np.mean(np.sum(errors**2, axis=0)) == pytest.approx(6.0, rel=0.04)


def test_the_seed_of_the_scenario_drifts_otherwise() -> None:
    first, second = (drifting_odometry(straight(10), Drift(), "a0", seed) for seed in (0, 1))
    assert not np.allclose(first, second, atol=1e-5)


def test_a_covariance_is_stated_for_every_keyframe_but_the_first() -> None:
    path = straight(10)
    assert keyframe_covariances(path, [], Drift()) == []
    assert keyframe_covariances(path, [3], Drift()) == [None]
    first, second, third = keyframe_covariances(path, [0, 2, 10], Drift(translation_per_sqrt_m=0.1))
    assert first is None
    assert second is not None
    assert third is not None
    # Along the track nothing turns into translation: it is the random walk alone.
    assert [second[3, 3], third[3, 3]] == pytest.approx([0.01 * 0.8, 0.01 * 3.2])
