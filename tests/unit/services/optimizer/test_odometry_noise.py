"""Covariances of odometry against sampling, and the weight of edges against the odometry itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from covinz.config import OdometryNoise
from covinz.frames import Array, local_error, so3_exp, transform
from services.optimizer.odometry_noise import (
    MAX_STEP_VARIANCE,
    composed,
    edge_shares,
    step_covariances,
)
from services.optimizer.segments import GrowingSegment, Segment
from tests.fleets import keyframe

WALK = OdometryNoise(
    rotation_per_sqrt_m=0.01,
    rotation_per_sqrt_rad=0.03,
    translation_per_sqrt_m=0.05,
    translation_per_sqrt_rad=0.07,
)


def random_transforms(rng: np.random.Generator, count: int) -> Array:
    return transform(so3_exp(rng.normal(size=(count, 3))), 3.0 * rng.normal(size=(count, 3)))


def random_covariances(rng: np.random.Generator, count: int, size: float) -> Array:
    A = size * rng.normal(size=(count, 6, 6))
    return A @ A.swapaxes(1, 2)


def segment_of(
    poses: Sequence[Array] | Array,
    covariances: Sequence[Array] | Array | None = None,
    seqs: Sequence[int] | None = None,
) -> Segment:
    segment = GrowingSegment(keyframe("a", 0, 0).id.segment)
    for row, T in enumerate(poses):
        kf = keyframe("a", 0, row if seqs is None else seqs[row], T)
        if covariances is not None:
            kf = dataclasses.replace(kf, covariance=covariances[row])
        segment.add(row, kf)
    return segment.frozen()


@pytest.mark.parametrize("num_steps", [1, 2, 4])
def test_composed_covariance_is_that_of_sampled_odometry(num_steps: int) -> None:
    rng = np.random.default_rng(2)
    steps = random_transforms(rng, num_steps)
    covariances = random_covariances(rng, num_steps, 0.004)
    count = 20_000
    total, sampled = np.eye(4), np.broadcast_to(np.eye(4), (count, 4, 4))
    for step, covariance in zip(steps, covariances, strict=True):
        xi = rng.multivariate_normal(np.zeros(6), covariance, size=count)
        total = total @ step
        sampled = sampled @ step @ transform(so3_exp(xi[:, :3]), xi[:, 3:])
    errors = local_error(total[None], sampled)
    (predicted,) = composed(steps, covariances, num_steps)
    whitened = np.linalg.solve(np.linalg.cholesky(predicted), errors.T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(6), atol=0.06)


def test_every_run_of_steps_is_composed() -> None:
    rng = np.random.default_rng(3)
    steps, covariances = random_transforms(rng, 5), random_covariances(rng, 5, 0.1)
    runs = composed(steps, covariances, 3)
    assert runs.shape == (3, 6, 6)
    for first in range(3):
        part = slice(first, first + 3)
        np.testing.assert_allclose(runs[first], composed(steps[part], covariances[part], 3)[0])


def test_a_random_walk_grows_with_metres_and_radians() -> None:
    turn = transform(so3_exp([0.0, 0.0, 0.5]), [0.0, 0.0, 0.0])
    walk = transform(np.eye(3), [3.0, 0.0, 4.0])
    covariance = step_covariances(segment_of([np.eye(4), turn, turn @ walk]), WALK)
    rotation, translation = 0.03**2 * 0.5, 0.07**2 * 0.5
    np.testing.assert_allclose(covariance[0], np.diag([rotation] * 3 + [translation] * 3))
    rotation, translation = 0.01**2 * 5.0, 0.05**2 * 5.0
    np.testing.assert_allclose(covariance[1], np.diag([rotation] * 3 + [translation] * 3))


def test_the_agents_covariance_goes_before_the_random_walk() -> None:
    poses = random_transforms(np.random.default_rng(4), 3)
    sent = random_covariances(np.random.default_rng(5), 3, 0.1)
    covariance = step_covariances(segment_of(poses, sent), WALK)
    np.testing.assert_allclose(covariance, sent[1:], rtol=1e-12)


def test_over_a_gap_the_random_walk_is_added_to_the_agents_covariance() -> None:
    poses = random_transforms(np.random.default_rng(4), 3)
    sent = random_covariances(np.random.default_rng(5), 3, 0.1)
    walk = step_covariances(segment_of(poses), WALK)
    covariance = step_covariances(segment_of(poses, sent, seqs=[0, 1, 5]), WALK)
    np.testing.assert_allclose(covariance[0], sent[1], rtol=1e-12)
    np.testing.assert_allclose(covariance[1], sent[2] + walk[1], rtol=1e-12)


@pytest.mark.parametrize(
    "bad",
    [
        np.full((6, 6), np.inf),
        np.diag([1.0, 1, 1, 1, 1, -1]),
        np.eye(6) + np.eye(6, k=1),
    ],
)
def test_a_covariance_that_is_none_counts_as_not_sent(bad: Array) -> None:
    poses = random_transforms(np.random.default_rng(4), 2)
    covariance = step_covariances(segment_of(poses, [bad, bad]), WALK)
    np.testing.assert_array_equal(covariance, step_covariances(segment_of(poses), WALK))


def test_a_huge_covariance_is_capped() -> None:
    poses = random_transforms(np.random.default_rng(4), 2)
    covariance = step_covariances(segment_of(poses, [np.eye(6), 1e12 * np.eye(6)]), WALK)
    np.testing.assert_allclose(covariance[0], MAX_STEP_VARIANCE * np.eye(6))


@pytest.mark.parametrize(("num_keyframes", "tolerance"), [(2, 1e-9), (5, 0.1), (200, 0.01)])
def test_shared_edges_carry_the_information_of_the_odometry_once(
    num_keyframes: int, tolerance: float
) -> None:
    # Keyframes on a line, unit variance a step: the far end has variance num_keyframes - 1.
    information = np.zeros((num_keyframes, num_keyframes))
    for span, share in enumerate(edge_shares(num_keyframes, 4), start=1):
        for row, weight in enumerate(share / span):
            ends = np.ix_([row, row + span], [row, row + span])
            information[ends] += weight * np.array([[1.0, -1.0], [-1.0, 1.0]])
    variance = np.linalg.inv(information[1:, 1:])[-1, -1]
    assert variance == pytest.approx(num_keyframes - 1, rel=tolerance)


def test_one_keyframe_has_no_edges() -> None:
    assert edge_shares(1, 4) == []
    assert edge_shares(0, 4) == []
