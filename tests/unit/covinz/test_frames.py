"""Rotations and rigid transforms: known values, inverses, and the split error convention."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from covinz import frames

Array = NDArray[np.float64]
seeds = st.integers(0, 2**32)
S = np.sqrt(0.5)
KNOWN = [
    # rotation vector, quaternion x y z w, image of (1, 2, 3)
    ([0, 0, 0], [0, 0, 0, 1], [1, 2, 3]),
    ([np.pi / 2, 0, 0], [S, 0, 0, S], [1, -3, 2]),
    ([0, np.pi / 2, 0], [0, S, 0, S], [3, 2, -1]),
    ([0, 0, np.pi / 2], [0, 0, S, S], [-2, 1, 3]),
    ([0, 0, np.pi], [0, 0, 1, 0], [-1, -2, 3]),
    (2 * np.pi / 3 * np.ones(3) / np.sqrt(3), [0.5, 0.5, 0.5, 0.5], [3, 1, 2]),
]


def random_poses(seed: int, *shape: int) -> Array:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(*shape, 3))
    return frames.transform(frames.so3_exp(vectors), rng.normal(size=(*shape, 3)))


@pytest.mark.parametrize(("vector", "quaternion", "image"), KNOWN)
def test_known_rotations(vector: Any, quaternion: Any, image: Any) -> None:
    R = frames.so3_exp(vector)
    np.testing.assert_allclose(R @ [1, 2, 3], image, atol=1e-14)
    np.testing.assert_allclose(frames.rotation_from_quaternion(quaternion), R, atol=1e-15)
    np.testing.assert_allclose(
        np.abs(frames.quaternion_from_rotation(R)), np.abs(quaternion), atol=1e-15
    )
    np.testing.assert_allclose(np.abs(frames.so3_log(R)), np.abs(vector), atol=1e-14)
    np.testing.assert_allclose(frames.rotation_angle(R), np.linalg.norm(vector), atol=1e-14)


@given(seeds, st.sampled_from([0.0, 1e-12, 1e-6, 1.0, 3.0, np.pi - 1e-7]))
def test_log_inverts_exp(seed: int, angle: float) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    vector = angle * axis / np.linalg.norm(axis)
    np.testing.assert_allclose(frames.so3_log(frames.so3_exp(vector)), vector, atol=1e-14)


@given(seeds)
def test_exp_inverts_log_also_at_half_turns(seed: int) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    for R in (frames.so3_exp(np.pi * axis / np.linalg.norm(axis)), frames.so3_exp(5 * axis)):
        np.testing.assert_allclose(frames.so3_exp(frames.so3_log(R)), R, atol=1e-14)
        assert np.linalg.norm(frames.so3_log(R)) <= np.pi + 1e-12


@given(seeds)
def test_quaternions_have_positive_w_and_length_one(seed: int) -> None:
    q = frames.quaternion_from_rotation(random_poses(seed, 20)[:, :3, :3])
    assert np.all(q[:, 3] >= 0)
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1)


@given(seeds)
def test_quaternion_of_any_length_is_normalised(seed: int) -> None:
    q = np.random.default_rng(seed).normal(size=4)
    R = frames.rotation_from_quaternion(q)
    np.testing.assert_allclose(frames.rotation_from_quaternion(-1000 * q), R, atol=1e-14)


@pytest.mark.parametrize("q", [[0, 0, 0, 0], [np.nan, 0, 0, 1]])
def test_no_rotation_without_a_quaternion(q: list[float]) -> None:
    with pytest.raises(ValueError, match="length zero or NaN"):
        frames.rotation_from_quaternion(q)


@given(seeds)
def test_inverse(seed: int) -> None:
    T = random_poses(seed, 5)
    identity = np.broadcast_to(np.eye(4), T.shape)
    np.testing.assert_allclose(frames.inverse(T) @ T, identity, atol=1e-14)
    np.testing.assert_allclose(T @ frames.inverse(T), identity, atol=1e-14)


@given(seeds)
def test_pose_round_trip(seed: int) -> None:
    T = random_poses(seed, 2, 3)
    pose = frames.pose_from_transform(T)
    assert pose.shape == (2, 3, 7)
    np.testing.assert_array_equal(pose[..., :3], T[..., :3, 3])
    np.testing.assert_allclose(frames.transform_from_pose(pose), T, atol=1e-14)


@given(seeds)
def test_stacks_are_treated_one_by_one(seed: int) -> None:
    T, other = random_poses(seed, 4), random_poses(seed + 1, 4)
    for i in range(4):
        one = frames.local_error(T[i], other[i])
        np.testing.assert_allclose(frames.local_error(T, other)[i], one, atol=1e-14)
        np.testing.assert_array_equal(frames.inverse(T)[i], frames.inverse(T[i]))


@given(seeds)
def test_local_error_is_the_split_right_perturbation(seed: int) -> None:
    """R = R_ref Exp(dr), p = p_ref + R_ref dp: the translation is not coupled to the rotation."""
    T_ref = random_poses(seed)
    error = np.random.default_rng(seed).normal(size=6)
    R = T_ref[:3, :3] @ frames.so3_exp(error[:3])
    T = frames.transform(R, T_ref[:3, 3] + T_ref[:3, :3] @ error[3:])
    expected = np.concatenate([frames.so3_log(frames.so3_exp(error[:3])), error[3:]])
    np.testing.assert_allclose(frames.local_error(T_ref, T), expected, atol=1e-13)


@given(seeds)
def test_local_error_does_not_depend_on_the_frame(seed: int) -> None:
    T_map_odom, T_ref, T = random_poses(seed, 3)
    moved = frames.local_error(T_map_odom @ T_ref, T_map_odom @ T)
    np.testing.assert_allclose(moved, frames.local_error(T_ref, T), atol=1e-12)


def test_interpolation_of_a_quarter_turn() -> None:
    T_0, T_1 = np.eye(4), frames.transform(frames.so3_exp([0, 0, np.pi / 2]), [2.0, 0, 4])
    half = frames.interpolate(T_0, T_1, 0.5)
    expected = frames.transform(frames.so3_exp([0, 0, np.pi / 4]), [1.0, 0, 2])
    np.testing.assert_allclose(half, expected, atol=1e-15)


@given(seeds, st.floats(0, 1))
def test_interpolation_runs_from_one_pose_to_the_other(seed: int, fraction: float) -> None:
    T_0, T_1 = random_poses(seed, 2)
    np.testing.assert_allclose(frames.interpolate(T_0, T_1, 0.0), T_0, atol=1e-14)
    np.testing.assert_allclose(frames.interpolate(T_0, T_1, 1.0), T_1, atol=1e-13)
    T = frames.interpolate(T_0, T_1, fraction)
    back = frames.interpolate(T_1, T_0, 1 - fraction)
    whole = frames.rotation_angle(frames.inverse(T_0) @ T_1)
    if whole < np.pi - 1e-6:
        np.testing.assert_allclose(T, back, atol=1e-8)
    angle = frames.rotation_angle(frames.inverse(T_0) @ T)
    np.testing.assert_allclose(angle, fraction * whole, atol=1e-13)


def test_rigid() -> None:
    T = random_poses(0)
    assert frames.is_rigid(T)
    scaled, mirrored, sheared, projective, nan = (T.copy() for _ in range(5))
    scaled[:3, :3] *= 1.001
    mirrored[:3, 0] *= -1
    sheared[0, 1] += 1e-3
    projective[3, 0] = 1e-9
    nan[0, 3] = np.nan
    for bad in (scaled, mirrored, sheared, projective, nan, np.eye(3)):
        assert not frames.is_rigid(bad)


def test_transform_broadcasts() -> None:
    T = frames.transform(np.eye(3), np.zeros((5, 3)))
    np.testing.assert_array_equal(T, np.broadcast_to(np.eye(4), (5, 4, 4)))


def test_adjoint_carries_a_perturbation_through_a_transform() -> None:
    rng = np.random.default_rng(1)
    T = frames.transform(frames.so3_exp(rng.normal(size=(5, 3))), 3.0 * rng.normal(size=(5, 3)))
    xi = 1e-6 * rng.normal(size=(5, 6))
    through = T @ frames.transform(frames.so3_exp(xi[:, :3]), xi[:, 3:]) @ frames.inverse(T)
    expected = np.einsum("nij,nj->ni", frames.adjoint(T), xi)
    np.testing.assert_allclose(frames.local_error(np.eye(4)[None], through), expected, atol=1e-10)
