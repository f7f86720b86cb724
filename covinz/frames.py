"""Rigid transforms: (4, 4) arrays ``T_a_b`` with ``p_a = T_a_b @ p_b``, and SO(3).

Quaternions are x, y, z, w with w >= 0. All functions work on stacks: leading axes are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def transform(R: ArrayLike, p: ArrayLike) -> Array:
    """Build (..., 4, 4) transforms from rotations (..., 3, 3) and translations (..., 3)."""
    rotation, translation = np.asarray(R, dtype=float), np.asarray(p, dtype=float)
    T = np.zeros((*np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1]), 4, 4))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1.0
    return T


def inverse(T_a_b: Array) -> Array:
    """T_b_a of rigid transforms (..., 4, 4)."""
    R_t = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    T_b_a = np.zeros(T_a_b.shape)
    T_b_a[..., :3, :3] = R_t
    T_b_a[..., :3, 3] = -np.einsum("...ij,...j->...i", R_t, T_a_b[..., :3, 3])
    T_b_a[..., 3, 3] = 1.0
    return T_b_a


def is_rigid(T: ArrayLike, tolerance: float = 1e-6) -> bool:
    """Whether a (4, 4) array is finite, orthonormal, right-handed and homogeneous."""
    matrix = np.asarray(T, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return False
    R = matrix[:3, :3]
    return bool(
        np.allclose(R.T @ R, np.eye(3), atol=tolerance)
        and np.linalg.det(R) > 0
        and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0])
    )


def rotation_from_quaternion(q_xyzw: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of quaternions (..., 4); normalises, raises ValueError near zero."""
    q = np.asarray(q_xyzw, dtype=float)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(norm > 1e-9):
        raise ValueError("a quaternion of length zero or NaN has no rotation")
    unit = q / norm
    x, y, z, w = unit[..., 0], unit[..., 1], unit[..., 2], unit[..., 3]
    R = np.empty((*q.shape[:-1], 3, 3))
    R[..., 0, 0] = 1 - 2 * (y * y + z * z)
    R[..., 0, 1] = 2 * (x * y - z * w)
    R[..., 0, 2] = 2 * (x * z + y * w)
    R[..., 1, 0] = 2 * (x * y + z * w)
    R[..., 1, 1] = 1 - 2 * (x * x + z * z)
    R[..., 1, 2] = 2 * (y * z - x * w)
    R[..., 2, 0] = 2 * (x * z - y * w)
    R[..., 2, 1] = 2 * (y * z + x * w)
    R[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return R


def quaternion_from_rotation(R: ArrayLike) -> Array:
    """Unit quaternions (..., 4), w >= 0, of rotations (..., 3, 3).

    Source: Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix",
    JGCD 2000: the eigenvector of the largest eigenvalue, well conditioned at every angle.
    """
    r = np.asarray(R, dtype=float)
    K = np.empty((*r.shape[:-2], 4, 4))
    K[..., 0, 0] = r[..., 0, 0] - r[..., 1, 1] - r[..., 2, 2]
    K[..., 1, 1] = r[..., 1, 1] - r[..., 0, 0] - r[..., 2, 2]
    K[..., 2, 2] = r[..., 2, 2] - r[..., 0, 0] - r[..., 1, 1]
    K[..., 3, 3] = r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2]
    K[..., 0, 1] = K[..., 1, 0] = r[..., 0, 1] + r[..., 1, 0]
    K[..., 0, 2] = K[..., 2, 0] = r[..., 0, 2] + r[..., 2, 0]
    K[..., 1, 2] = K[..., 2, 1] = r[..., 1, 2] + r[..., 2, 1]
    K[..., 0, 3] = K[..., 3, 0] = r[..., 2, 1] - r[..., 1, 2]
    K[..., 1, 3] = K[..., 3, 1] = r[..., 0, 2] - r[..., 2, 0]
    K[..., 2, 3] = K[..., 3, 2] = r[..., 1, 0] - r[..., 0, 1]
    _, vectors = np.linalg.eigh(K)
    q: Array = vectors[..., :, -1]
    return np.where(q[..., 3:] < 0, -q, q)


def pose_from_transform(T: ArrayLike) -> Array:
    """Transforms (..., 4, 4) as (..., 7): x, y, z, then quaternion x, y, z, w."""
    matrix = np.asarray(T, dtype=float)
    q = quaternion_from_rotation(matrix[..., :3, :3])
    return np.concatenate([matrix[..., :3, 3], q], axis=-1)


def transform_from_pose(pose: ArrayLike) -> Array:
    """Inverse of `pose_from_transform`; raises ValueError on a zero quaternion."""
    values = np.asarray(pose, dtype=float)
    return transform(rotation_from_quaternion(values[..., 3:]), values[..., :3])


def so3_exp(rotation_vector: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    v = np.asarray(rotation_vector, dtype=float)
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    # sin(a/2)/a, finite at zero
    scale = 0.5 * np.sinc(angle / (2 * np.pi))
    return rotation_from_quaternion(np.concatenate([scale * v, np.cos(angle / 2)], axis=-1))


def so3_log(R: ArrayLike) -> Array:
    """Rotation vectors (..., 3) [rad], length <= pi, of rotations (..., 3, 3)."""
    q = quaternion_from_rotation(R)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., 3:])
    scale = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)
    vector: Array = scale * q[..., :3]
    return vector


def rotation_angle(T_or_R: ArrayLike) -> Array:
    """Angle [rad] in [0, pi] of rotations (..., 3, 3) or transforms (..., 4, 4)."""
    R = np.asarray(T_or_R, dtype=float)[..., :3, :3]
    # Sine and cosine, twice each: no axis is needed, so this is good at every angle, and fast.
    x, y, z = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    angle: Array = np.arctan2(np.sqrt(x * x + y * y + z * z), trace - 1.0)
    return angle


def local_error(T_ref: Array, T: Array) -> Array:
    """Right perturbation (..., 6) [rotation (rad), translation (m)] that takes T_ref to T.

    The split form used everywhere in covinz: ``R = R_ref Exp(dr)``, ``p = p_ref + R_ref dp``.
    """
    delta = inverse(T_ref) @ T
    return np.concatenate([so3_log(delta[..., :3, :3]), delta[..., :3, 3]], axis=-1)


def adjoint(T_a_b: Array) -> Array:
    """(..., 6, 6) that carries a right perturbation of a pose from frame b to frame a.

    ``T_a_b Exp(xi) T_b_a = Exp(adjoint(T_a_b) xi)`` to first order. The zero blocks and the order
    follow from the tangent [rotation, translation].
    """
    R, p = T_a_b[..., :3, :3], T_a_b[..., :3, 3]
    p_cross = np.zeros_like(R)
    p_cross[..., 0, 1], p_cross[..., 0, 2], p_cross[..., 1, 2] = -p[..., 2], p[..., 1], -p[..., 0]
    p_cross[..., 1, 0], p_cross[..., 2, 0], p_cross[..., 2, 1] = p[..., 2], -p[..., 1], p[..., 0]
    result = np.zeros((*R.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = R
    result[..., 3:, :3] = p_cross @ R
    return result


def interpolate(T_0: Array, T_1: Array, fraction: float) -> Array:
    """Pose between two (4, 4) poses: constant angular velocity, straight line."""
    R = T_0[:3, :3] @ so3_exp(fraction * so3_log(T_0[:3, :3].T @ T_1[:3, :3]))
    return transform(R, (1 - fraction) * T_0[:3, 3] + fraction * T_1[:3, 3])
