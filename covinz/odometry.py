"""How far odometry can be trusted: covariances of motions over one keyframe or several.

Covariances are of the right perturbation [rotation (rad), translation (m)] of a motion, in the
frame of the later body.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from covinz.config import OdometryNoise
from covinz.frames import adjoint, inverse, rotation_angle
from covinz.types import Array

# Nothing is measured better, however sure a front-end is of itself: 0.1 mrad and 1 mm. Keeps
# covariances positive definite that were sent for a robot that stood still.
FLOOR = np.diag(np.repeat([1e-4**2, 1e-3**2], 3))
FLOOR.setflags(write=False)
# A variance beyond this says nothing: a turn in full, or ten metres, between neighbours.
MAX_STEP_VARIANCE = 100.0
# Motions of kilometres (an odometry that blew up) are levers; beyond this only rounding is left.
MAX_VARIANCE = 1e4


def random_walk(T_a_b: Array, noise: OdometryNoise) -> Array:
    """(6, 6) covariance of a motion whose error grows with its metres and radians.

    Source: COVINS-G III-C, "the expected accuracy of the corresponding front-end".
    """
    moved_m = float(np.linalg.norm(T_a_b[:3, 3]))
    turned_rad = float(rotation_angle(T_a_b))
    rotation = noise.rotation_per_sqrt_m**2 * moved_m + noise.rotation_per_sqrt_rad**2 * turned_rad
    translation = (
        noise.translation_per_sqrt_m**2 * moved_m + noise.translation_per_sqrt_rad**2 * turned_rad
    )
    return np.diag(np.repeat([rotation, translation], 3))


def usable(covariance: Array | None) -> Array | None:
    """A step's covariance as a robot sent it, made symmetric; None when it says nothing."""
    if covariance is None or not np.all(np.abs(covariance) <= MAX_STEP_VARIANCE):
        return None
    size = np.abs(covariance).max()
    symmetric: Array = 0.5 * (covariance + covariance.T)
    if np.abs(covariance - symmetric).max() > 1e-6 * size:
        return None
    return symmetric if np.linalg.eigvalsh(symmetric)[0] >= -1e-9 * size else None


def motion_covariance(
    T_odom_body: Array, sent: Sequence[Array | None], noise: OdometryNoise
) -> Array:
    """(6, 6) covariance of the motion from the first of consecutive keyframes to the last.

    An error before a step is seen from behind it through the adjoint of the step backwards:
    ``S <- A S A^T + Q`` with ``A = adjoint(T_cur_prev)``. Positive definite, whatever was sent.

    Args:
        T_odom_body: (N, 4, 4) their odometry poses in order of time, N >= 2.
        sent: N - 1 covariances of the steps between them as their robot sent them; where it sent
            None, or what is no covariance, the front-end's usual accuracy stands in.
        noise: That accuracy; its floor is added once to a motion that needs it.

    Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships", 1990
    (compounding), for the right perturbation.
    """
    total, is_walk = np.zeros((6, 6)), False
    for T_prev, T_cur, covariance in zip(T_odom_body[:-1], T_odom_body[1:], sent, strict=True):
        T_prev_cur = inverse(T_prev) @ T_cur
        step = usable(covariance)
        is_walk |= step is None
        back = adjoint(inverse(T_prev_cur))
        total = back @ total @ back.T + (random_walk(T_prev_cur, noise) if step is None else step)
    if is_walk:
        total = total + np.diag(np.repeat([noise.min_rotation**2, noise.min_translation**2], 3))
    total = 0.5 * (total + total.T)
    if np.abs(total).max() > MAX_VARIANCE:
        variances, directions = np.linalg.eigh(total)
        total = (directions * np.clip(variances, 0.0, MAX_VARIANCE)) @ directions.T
        total = 0.5 * (total + total.T)
    return total + FLOOR
