"""Odometry made of true motion and a seeded random walk."""

from __future__ import annotations

import hashlib

import numpy as np

from covinz import frames
from covinz.scenario import Drift
from covinz.types import Array


def seed_of(*parts: object) -> int:
    """A seed that depends on every part, e.g. a scenario's seed and an agent's id."""
    text = "/".join(str(part) for part in parts)
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "big")


def drifting_odometry(T_world_body: Array, drift: Drift, agent_id: str) -> Array:
    """Odometry of a robot that starts at its origin and drifts.

    Every true motion between two frames is composed with a small random one whose variance is
    proportional to the metres and radians of the true motion, so that the error after a path
    does not depend on the number of frames on it.

    Args:
        T_world_body: (N, 4, 4) true poses in order of time.
        drift: Sigmas and seed.
        agent_id: Agents with the same seed drift independently.

    Returns:
        (N, 4, 4) ``T_odom_body``, the first the identity.

    Source: paper III-C, where the covariance of an odometry edge grows with its motion.
    """
    if len(T_world_body) == 0:
        return np.empty((0, 4, 4))
    T_prev_cur = frames.inverse(T_world_body[:-1]) @ T_world_body[1:]
    moved_m = np.linalg.norm(T_prev_cur[:, :3, 3], axis=-1)
    turned_rad = frames.rotation_angle(T_prev_cur)
    variances = [
        per_m**2 * moved_m + per_rad**2 * turned_rad
        for per_m, per_rad in (
            (drift.rotation_per_sqrt_m, drift.rotation_per_sqrt_rad),
            (drift.translation_per_sqrt_m, drift.translation_per_sqrt_rad),
        )
    ]
    rng = np.random.default_rng(seed_of("drift", drift.seed, agent_id))
    noise = rng.normal(size=(2, len(T_prev_cur), 3)) * np.sqrt(variances)[:, :, None]
    T_prev_cur = T_prev_cur @ frames.transform(frames.so3_exp(noise[0]), noise[1])
    T_odom_body = np.empty_like(T_world_body)
    T_odom_body[0] = np.eye(4)
    for i, step in enumerate(T_prev_cur):
        T_odom_body[i + 1] = T_odom_body[i] @ step
    return T_odom_body
