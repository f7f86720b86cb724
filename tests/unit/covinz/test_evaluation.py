"""Alignment, ATE, RPE and NEES against values computed by hand, and their invariances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz import evaluation as ev
from covinz import frames
from covinz.trajectory import Trajectory
from covinz.types import Array

SECOND = 1_000_000_000
seeds = st.integers(min_value=0, max_value=2**32 - 1)


def random_pose(rng: np.random.Generator, spread_m: float = 5.0) -> Array:
    return frames.transform(frames.so3_exp(rng.normal(size=3)), spread_m * rng.normal(size=3))


def pairs_of(est: list[list[float]], ref: list[list[float]]) -> ev.PosePairs:
    """Poses without rotation at the given positions, one a second."""
    return ev.PosePairs(
        np.arange(len(est)) * SECOND,
        frames.transform(np.eye(3), np.array(est)),
        frames.transform(np.eye(3), np.array(ref)),
    )


def random_pairs(rng: np.random.Generator, n: int = 20, noise_m: float = 0.1) -> ev.PosePairs:
    T_ref = np.array([random_pose(rng) for _ in range(n)])
    noise = frames.transform(
        frames.so3_exp(0.05 * rng.normal(size=(n, 3))), noise_m * rng.normal(size=(n, 3))
    )
    return ev.PosePairs(np.arange(n) * SECOND, T_ref @ noise, T_ref)


def moved(pairs: ev.PosePairs, T_new_est: Array) -> ev.PosePairs:
    return ev.PosePairs(pairs.stamps_ns, T_new_est @ pairs.T_est_body, pairs.T_ref_body)


# --- alignment and ATE


@given(seeds)
def test_alignment_recovers_a_rigid_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, points = random_pose(rng), rng.normal(size=(10, 3))
    T_found = ev.align(points, points @ T[:3, :3].T + T[:3, 3])
    assert np.allclose(T_found, T, atol=1e-9)


def test_alignment_never_mirrors() -> None:
    points = np.random.default_rng(0).normal(size=(10, 3))
    assert frames.is_rigid(ev.align(points, points * [1, 1, -1]))


def test_degenerate_points_are_still_aligned() -> None:
    one = ev.align([[1.0, 2, 3]], [[4.0, 4, 4]])
    assert np.array_equal(one, frames.transform(np.eye(3), [3.0, 2, 1]))
    T = random_pose(np.random.default_rng(3))
    line = np.outer(np.linspace(0, 4, 7), [1.0, 2, 0.5])
    target = line @ T[:3, :3].T + T[:3, 3]
    found = ev.align(line, target)
    assert frames.is_rigid(found)
    assert np.allclose(line @ found[:3, :3].T + found[:3, 3], target)


def test_no_points_cannot_be_aligned() -> None:
    with pytest.raises(ValueError, match="cannot align"):
        ev.align(np.empty((0, 3)), np.empty((0, 3)))
    with pytest.raises(ValueError, match="cannot align"):
        ev.alignment([])


def test_ate_of_a_known_case() -> None:
    """A square of side 2 whose corners are drawn out by 0.1 and in by 0.1 in turn along x."""
    square: list[list[float]] = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    bent: list[list[float]] = [[-1.1, -1, 0], [1.1, -1, 0], [0.9, 1, 0], [-0.9, 1, 0]]
    assert ev.ate_m(pairs_of(bent, square)) == pytest.approx(0.1)


def test_ate_takes_no_scale_out() -> None:
    """Half the size: mean distance from the centroid is 1 instead of 2."""
    assert ev.ate_m(pairs_of([[-1.0, 0, 0], [1, 0, 0]], [[-2.0, 0, 0], [2, 0, 0]])) == 1.0


@given(seeds)
def test_ate_does_not_depend_on_the_frame_of_the_estimate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = random_pairs(rng)
    assert ev.ate_m(moved(pairs, random_pose(rng))) == pytest.approx(ev.ate_m(pairs), rel=1e-6)


def test_joint_ate_sees_a_shift_between_agents_that_separate_ate_does_not() -> None:
    """Two equal runs, one map 1 m apart: one alignment splits the metre in halves."""
    rng = np.random.default_rng(1)
    first = random_pairs(rng, noise_m=0.0)
    shift = frames.transform(np.eye(3), [0.0, 0, 1])
    second = moved(first, shift)
    assert ev.separate_ate_m([first, second]) == pytest.approx(0, abs=1e-9)
    assert ev.joint_ate_m([first, second]) == pytest.approx(0.5)
    assert ev.joint_ate_m([first]) == pytest.approx(ev.ate_m(first), abs=1e-12)


@given(seeds)
def test_joint_ate_is_never_below_the_separate_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    runs = [random_pairs(rng, n) for n in (5, 9, 14)]
    assert ev.joint_ate_m(runs) >= ev.separate_ate_m(runs) - 1e-12
    assert ev.joint_ate_m(runs) == pytest.approx(ev.joint_ate_m(runs[::-1]))


def test_separate_ate_pools_by_poses() -> None:
    exact = pairs_of([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    scaled = pairs_of([[-1.0, 0, 0], [1, 0, 0]], [[-2.0, 0, 0], [2, 0, 0]])
    assert ev.separate_ate_m([exact, scaled]) == pytest.approx(np.sqrt(2 / 5))


def test_nothing_to_average_is_an_error() -> None:
    nothing = ev.PosePairs(np.empty(0, np.int64), np.empty((0, 4, 4)), np.empty((0, 4, 4)))
    with pytest.raises(ValueError, match="cannot align"):
        ev.ate_m(nothing)
    with pytest.raises(ValueError, match="no pose has ground truth"):
        ev.separate_ate_m([nothing])


# --- association


def test_association_interpolates_within_the_gap_and_leaves_out_the_rest() -> None:
    x = np.array([0.0, 1.0, 2.0, 9.0])
    groundtruth = Trajectory(
        np.array([0, 10, 20, 90]), frames.transform(np.eye(3), x[:, None] * [1.0, 0, 0])
    )
    estimate = Trajectory(np.array([5, 20, 50, 95]), np.array([np.eye(4)] * 4))
    pairs = ev.associate(estimate, groundtruth, max_gap_ns=10)
    assert pairs.stamps_ns.tolist() == [5, 20]
    assert pairs.T_ref_body[:, 0, 3].tolist() == [0.5, 2.0]


# --- RPE


def drifting_line(n: int = 11, step_m: float = 1.0, scale: float = 1.02) -> ev.PosePairs:
    x = np.arange(n) * step_m
    return pairs_of([[scale * v, 0.0, 0.0] for v in x], [[v, 0.0, 0.0] for v in x])


def test_rpe_over_distance_of_a_scale_error() -> None:
    errors = ev.rpe_over_distance(drifting_line(), 5.0)
    assert len(errors.translation_m) == 6
    assert np.allclose(errors.translation_m, 0.1)
    assert np.allclose(errors.rotation_rad, 0.0)


def test_rpe_over_time() -> None:
    errors = ev.rpe_over_time(drifting_line(), 2 * SECOND)
    assert len(errors.translation_m) == 9
    assert np.allclose(errors.translation_m, 0.04)


def test_rpe_of_a_heading_drift() -> None:
    """Turning 0.01 rad too much every second."""
    n = 6
    T_ref = np.array([np.eye(4)] * n)
    R = frames.so3_exp(np.arange(n)[:, None] * [0, 0, 0.01])
    T_est = frames.transform(R, np.zeros((n, 3)))
    errors = ev.rpe_over_time(ev.PosePairs(np.arange(n) * SECOND, T_est, T_ref), 3 * SECOND)
    assert np.allclose(errors.rotation_rad, [0.03] * 3)


@given(seeds)
def test_rpe_needs_no_alignment(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = random_pairs(rng)
    plain, shifted = (ev.rpe_over_time(p, SECOND) for p in (pairs, moved(pairs, random_pose(rng))))
    assert np.allclose(plain.translation_m, shifted.translation_m, atol=1e-9)
    assert np.allclose(plain.rotation_rad, shifted.rotation_rad, atol=1e-7)


def test_rpe_beyond_the_end_is_empty() -> None:
    assert len(ev.rpe_over_distance(drifting_line(), 11.0).translation_m) == 0


@pytest.mark.parametrize("delta", [0, -1])
def test_rpe_wants_a_positive_delta(delta: int) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        ev.rpe_over_time(drifting_line(), delta)
    with pytest.raises(ValueError, match="must be positive"):
        ev.rpe_over_distance(drifting_line(), delta)


# --- loops and NEES


def test_relative_errors_of_a_known_loop() -> None:
    T_true = random_pose(np.random.default_rng(5))
    T_est = T_true @ frames.transform(frames.so3_exp([0, 0.3, 0]), [0.0, 3.0, 4.0])
    errors = ev.relative_errors(T_true, T_est)
    assert errors.translation_m == pytest.approx(5.0)
    assert errors.rotation_rad == pytest.approx(0.3)


def test_true_loop_takes_query_points_to_the_candidate() -> None:
    rng = np.random.default_rng(6)
    T_world_cand, T_world_query = random_pose(rng), random_pose(rng)
    T_cand_query = ev.true_loops(T_world_cand, T_world_query)
    point_query = np.array([1.0, 2.0, 3.0, 1.0])
    assert np.allclose(T_world_cand @ T_cand_query @ point_query, T_world_query @ point_query)


def test_nees_of_one_sigma_in_each_axis() -> None:
    """The error lives in the body of the estimate: rotated there, then divided by sigma."""
    sigma = np.array([0.01, 0.02, 0.03, 0.1, 0.2, 0.3])
    T_est = random_pose(np.random.default_rng(7))
    for axis in range(6):
        step = np.zeros(6)
        step[axis] = sigma[axis]
        T_true = T_est @ frames.transform(frames.so3_exp(step[:3]), step[3:])
        assert ev.nees(T_true, T_est, np.diag(sigma**2)) == pytest.approx(1.0)


def test_nees_is_six_on_average_for_an_honest_covariance() -> None:
    rng = np.random.default_rng(8)
    factor = 0.02 * rng.normal(size=(6, 6))
    covariance = factor @ factor.T + 1e-6 * np.eye(6)
    error = rng.multivariate_normal(np.zeros(6), covariance, size=4000)
    T_est = random_pose(rng)
    T_true = T_est @ frames.transform(frames.so3_exp(error[:, :3]), error[:, 3:])
    assert np.mean(ev.nees(T_true, T_est, covariance)) == pytest.approx(6.0, abs=0.3)


def test_nees_refuses_what_is_no_covariance() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        ev.nees(np.eye(4), np.eye(4), -np.eye(6))
