from __future__ import annotations

from collections.abc import Sequence

import covinz_core
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz import frames
from covinz.config import OdometryNoise
from covinz.types import Array

NOISE = OdometryNoise()
CORE_NOISE = covinz_core.OdometryNoise(**NOISE.model_dump())
# Of core/include/covinz/odometry.h.
FLOOR = np.diag(np.repeat([1e-4**2, 1e-3**2], 3))
MAX_VARIANCE = 1e4
FLOOR_OF_WALK = np.diag(np.repeat([NOISE.min_rotation**2, NOISE.min_translation**2], 3)) + FLOOR


def motion_covariance(T_odom_body: Array, sent: Sequence[Array | None]) -> Array:
    return covinz_core.motion_covariance(list(T_odom_body), sent, CORE_NOISE)


def random_walk(T_a_b: Array) -> Array:
    return covinz_core.random_walk(T_a_b, CORE_NOISE)


def walk(rng: np.random.Generator, count: int, step_m: float = 0.3) -> Array:
    T = [frames.transform(frames.so3_exp(rng.normal(size=3)), rng.normal(scale=5.0, size=3))]
    for _ in range(count - 1):
        turn, move = rng.normal(scale=0.2, size=3), rng.normal(scale=step_m, size=3)
        T.append(T[-1] @ frames.transform(frames.so3_exp(turn), move))
    return np.stack(T)


def sent(rng: np.random.Generator, scale: float = 1e-3) -> Array:
    half = rng.normal(scale=scale, size=(6, 6))
    covariance: Array = half @ half.T
    return covariance


def test_composition_is_that_of_random_motions() -> None:
    rng = np.random.default_rng(3)
    T = walk(rng, 4)
    steps = [sent(rng) for _ in range(3)]
    found = motion_covariance(T, steps)
    halves = [np.linalg.cholesky(step) for step in steps]
    truth = frames.inverse(T[0]) @ T[-1]
    errors = []
    for _ in range(4000):
        moved = np.eye(4)
        for i, half in enumerate(halves):
            error = half @ rng.normal(size=6)
            step = frames.inverse(T[i]) @ T[i + 1]
            moved = moved @ step @ frames.transform(frames.so3_exp(error[:3]), error[3:])
        errors.append(frames.local_error(truth, moved))
    sampled = np.cov(np.array(errors).T)
    scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(sampled / scale, (found - FLOOR) / scale, atol=0.08)


def test_one_step_is_what_was_sent_or_a_random_walk() -> None:
    rng = np.random.default_rng(4)
    T = walk(rng, 2)
    covariance = sent(rng)
    np.testing.assert_allclose(motion_covariance(T, [covariance]), covariance + FLOOR)
    step = random_walk(frames.inverse(T[0]) @ T[1])
    np.testing.assert_allclose(motion_covariance(T, [None]), step + FLOOR_OF_WALK)


def test_a_random_walk_grows_with_metres_and_radians() -> None:
    two_m = random_walk(frames.transform(np.eye(3), [0.0, 2.0, 0.0]))
    np.testing.assert_allclose(np.diag(two_m)[3:], 2 * NOISE.translation_per_sqrt_m**2)
    np.testing.assert_allclose(np.diag(two_m)[:3], 2 * NOISE.rotation_per_sqrt_m**2)
    turn = random_walk(frames.transform(frames.so3_exp([0.0, 0.5, 0.0]), np.zeros(3)))
    np.testing.assert_allclose(np.diag(turn)[:3], 0.5 * NOISE.rotation_per_sqrt_rad**2)


def test_there_and_back_is_as_uncertain_as_the_way() -> None:
    """The same place again, by a way of two metres: not the covariance of standing still."""
    T = np.stack([frames.transform(np.eye(3), [x_m, 0.0, 0.0]) for x_m in (0.0, 1.0, 0.0)])
    found = motion_covariance(T, [None, None])
    assert np.diag(found)[3] == pytest.approx(
        2 * NOISE.translation_per_sqrt_m**2 + FLOOR_OF_WALK[3, 3]
    )


BAD = [
    np.full((6, 6), np.nan),
    np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1.0]),
    np.eye(6) + np.eye(6, k=1),
    1e3 * np.eye(6),
    np.diag([np.inf] * 6),
]


@pytest.mark.parametrize("bad", BAD)
def test_a_covariance_that_says_nothing_counts_as_not_sent(bad: Array) -> None:
    T = walk(np.random.default_rng(5), 3)
    np.testing.assert_array_equal(
        motion_covariance(T, [bad, bad]), motion_covariance(T, [None, None])
    )


def test_zeros_are_a_covariance() -> None:
    T = walk(np.random.default_rng(6), 2)
    np.testing.assert_array_equal(motion_covariance(T, [np.zeros((6, 6))]), FLOOR)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1.0, 1e4, 1e8]))
def test_it_is_positive_definite_and_bounded_whatever_was_sent(seed: int, step_m: float) -> None:
    rng = np.random.default_rng(seed)
    T = walk(rng, 6, step_m)
    steps = [sent(rng, 3.0) if rng.random() < 0.7 else None for _ in range(5)]
    found = motion_covariance(T, steps)
    np.testing.assert_array_equal(found, found.T)
    np.linalg.cholesky(found)
    assert np.linalg.eigvalsh(found)[-1] <= 1.001 * MAX_VARIANCE + FLOOR.max()


def test_the_odometry_s_frame_does_not_matter() -> None:
    rng = np.random.default_rng(8)
    T = walk(rng, 5)
    steps = [sent(rng), None, sent(rng), None]
    moved = frames.transform(frames.so3_exp([0.3, 0.1, -2.0]), [30.0, 2.0, -8.0]) @ T
    np.testing.assert_allclose(
        motion_covariance(T, steps), motion_covariance(moved, steps), rtol=1e-9,
        atol=1e-15,
    )  # fmt: skip


@pytest.mark.parametrize("field", OdometryNoise.model_fields)
def test_negative_noise_is_refused(field: str) -> None:
    with pytest.raises(ValueError, match="Odometry"):
        covinz_core.OdometryNoise(**{**NOISE.model_dump(), field: -1.0})
