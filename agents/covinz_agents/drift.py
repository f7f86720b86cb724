"""Odometry made of true motion and a seeded random walk, and how well such a robot knows it."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence

import numpy as np

from covinz import frames
from covinz.scenario import Drift
from covinz.types import Array


def seed_of(*parts: object) -> int:
    """A seed that depends on every part, e.g. a scenario's seed and an agent's id."""
    text = "/".join(str(part) for part in parts)
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "big")


def drifting_odometry(T_world_body: Array, drift: Drift, agent_id: str, seed: int = 0) -> Array:
    """Odometry of a robot that starts at its origin and drifts.

    Every true motion between two frames is composed with a small random one whose variance is
    proportional to the metres and radians of the true motion, so that the error after a path
    does not depend on the number of frames on it.

    Args:
        T_world_body: (N, 4, 4) true poses in order of time.
        drift: Sigmas and seed.
        agent_id: Agents with the same seed drift independently.
        seed: The scenario's; added to the drift's.

    Returns:
        (N, 4, 4) ``T_odom_body``, the first the identity.

    Source: paper III-C, where the covariance of an odometry edge grows with its motion.
    """
    if len(T_world_body) == 0:
        return np.empty((0, 4, 4))
    T_prev_cur = frames.inverse(T_world_body[:-1]) @ T_world_body[1:]
    rng = np.random.default_rng(seed_of("drift", drift.seed + seed, agent_id))
    sigmas = np.sqrt(_variances(T_prev_cur, drift))
    noise = rng.normal(size=(2, len(T_prev_cur), 3)) * sigmas[:, :, None]
    T_prev_cur = T_prev_cur @ frames.transform(frames.so3_exp(noise[0]), noise[1])
    T_odom_body = np.empty_like(T_world_body)
    T_odom_body[0] = np.eye(4)
    for i, step in enumerate(T_prev_cur):
        T_odom_body[i + 1] = T_odom_body[i] @ step
    return T_odom_body


def keyframe_covariances(
    T_odom_body: Array, keyframes: Sequence[int], drift: Drift
) -> list[Array | None]:
    """What a robot that knows its drift says of the motion from each keyframe to the next.

    Args:
        T_odom_body: (N, 4, 4) its odometry, every frame.
        keyframes: Rows of the keyframes, ascending.
        drift: Its sigmas; the metres and radians are those that the odometry measured.

    Returns:
        For each keyframe the (6, 6) covariance since the previous one: right perturbation
        [rotation (rad), translation (m)] of ``T_prev_cur``, in the current body frame. None for
        the first.

    Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships", 1990
    (compounding), for the right perturbation.
    """
    T_prev_cur = frames.inverse(T_odom_body[:-1]) @ T_odom_body[1:]
    rotation, translation = _variances(T_prev_cur, drift)
    steps = np.zeros((len(T_prev_cur), 6, 6))
    steps[:, (0, 1, 2), (0, 1, 2)] = rotation[:, None]
    steps[:, (3, 4, 5), (3, 4, 5)] = translation[:, None]
    back = frames.adjoint(frames.inverse(T_prev_cur))
    found: list[Array | None] = [None] * min(1, len(keyframes))
    for first, last in itertools.pairwise(keyframes):
        total = np.zeros((6, 6))
        for A, step in zip(back[first:last], steps[first:last], strict=True):
            total = A @ total @ A.T + step
        found.append(0.5 * (total + total.T))
    return found


def _variances(T_prev_cur: Array, drift: Drift) -> Array:
    """(2, N) variance per axis of the rotation [rad^2] and translation [m^2] of each motion."""
    moved_m = np.linalg.norm(T_prev_cur[:, :3, 3], axis=-1)
    turned_rad = frames.rotation_angle(T_prev_cur)
    return np.stack(
        [
            per_m**2 * moved_m + per_rad**2 * turned_rad
            for per_m, per_rad in (
                (drift.rotation_per_sqrt_m, drift.rotation_per_sqrt_rad),
                (drift.translation_per_sqrt_m, drift.translation_per_sqrt_rad),
            )
        ]
    )
