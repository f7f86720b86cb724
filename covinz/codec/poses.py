"""Transforms as they travel: x, y, z [m] and a unit quaternion x, y, z, w.

A transform goes through a quaternion on the wire and a process may send on what it received, so
the way there and back must not add noise: ``wire -> transform -> wire`` returns the same bits. The
quaternion is therefore rounded before it is sent. Its ratios to its largest component are put on a
grid of 2^-44 (6e-14 rad), far above the 1e-15 that the conversions lose, and far below what any
odometry knows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from covinz import frames

Array = NDArray[np.float64]

# Coordinates beyond this are no robot's; it keeps squares of hostile input finite. [m]
MAX_COORDINATE_M = 1e9
UNIT_TOLERANCE = 1e-6
_GRID = 2.0**44


def pose_values(T: Array, name: str) -> Array:
    """Poses (..., 7) of transforms (..., 4, 4).

    Raises:
        ValueError: If one of them is not finite, rigid and within `MAX_COORDINATE_M`.
    """
    check_rigid(T, name)
    pose = frames.pose_from_transform(T)
    pose[..., 3:] = _on_grid(pose[..., 3:])
    return pose


def transforms(pose: ArrayLike, name: str) -> Array:
    """Transforms (..., 4, 4) of poses (..., 7); ValueError when one is not a pose."""
    values = np.asarray(pose, dtype=float)
    if not np.all(np.abs(values[..., :3]) <= MAX_COORDINATE_M):
        raise ValueError(f"{name}: translation is not finite or beyond {MAX_COORDINATE_M:g} m")
    q = values[..., 3:]
    # The first test also fails for NaN, and keeps the square finite.
    if not (np.all(np.abs(q) <= 2) and np.all(np.abs(_norm(q) - 1) <= UNIT_TOLERANCE)):
        raise ValueError(f"{name}: quaternion is not of length 1")
    return frames.transform_from_pose(values)


def check_rigid(T: Array, name: str) -> None:
    """Raise ValueError unless all transforms (..., 4, 4) are rigid within 1e-6."""
    if not np.all(np.abs(T[..., :3, 3]) <= MAX_COORDINATE_M):
        raise ValueError(f"{name}: translation is not finite or beyond {MAX_COORDINATE_M:g} m")
    R = T[..., :3, :3]
    rigid = np.all(np.abs(R) <= 2) and np.all(T[..., 3, :] == (0.0, 0.0, 0.0, 1.0))
    if rigid:
        error = np.swapaxes(R, -1, -2) @ R - np.eye(3)
        rigid = np.all(np.abs(error) <= UNIT_TOLERANCE) and np.all(np.linalg.det(R) > 0)
    if not rigid:
        raise ValueError(f"{name}: not a rigid transform")


def _norm(q: Array) -> Array:
    # Written out: a reduction's order of summation may depend on the shape of the stack.
    x, y, z, w = (q[..., i] for i in range(4))
    norm: Array = np.sqrt(x * x + y * y + z * z + w * w)
    return norm


def _on_grid(q: Array) -> Array:
    largest = np.take_along_axis(q, np.argmax(np.abs(q), axis=-1)[..., None], axis=-1)
    ratios = np.rint(q / largest * _GRID) / _GRID
    # One sign for q and -q: the last component that is not zero is positive.
    x, y, z, w = (ratios[..., i] for i in range(4))
    leading = np.where(w != 0, w, np.where(z != 0, z, np.where(y != 0, y, x)))
    ratios = np.where(leading[..., None] < 0, -ratios, ratios) + 0.0
    unit: Array = ratios / _norm(ratios)[..., None]
    return unit
