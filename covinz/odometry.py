"""How far odometry can be trusted: covariances of motions over one keyframe or several.

Covariances are of the right perturbation [rotation (rad), translation (m)] of a motion, in the
frame of the later body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True, eq=False)
class MotionStep:
    """What a step from one keyframe to the next does to the covariance of a motion.

    Attributes:
        back: (6, 6) carries an error before the step to behind it.
        covariance: (6, 6) the step's own.
        is_walk: Whether that is the front-end's usual accuracy, since the robot said nothing.
    """

    back: Array
    covariance: Array
    is_walk: bool


def motion_step(
    T_odom_prev: Array, T_odom_cur: Array, sent: Array | None, noise: OdometryNoise
) -> MotionStep:
    """The step between two odometry poses; arguments otherwise as of `motion_covariance`."""
    T_prev_cur = inverse(T_odom_prev) @ T_odom_cur
    own = usable(sent)
    return MotionStep(
        back=adjoint(inverse(T_prev_cur)),
        covariance=random_walk(T_prev_cur, noise) if own is None else own,
        is_walk=own is None,
    )


def compounded(steps: Sequence[MotionStep], noise: OdometryNoise) -> Array:
    """(6, 6) covariance of the motion over consecutive steps; see `motion_covariance`."""
    total = np.zeros((6, 6))
    for step in steps:
        total = step.back @ total @ step.back.T + step.covariance
    if any(step.is_walk for step in steps):
        total = total + np.diag(np.repeat([noise.min_rotation**2, noise.min_translation**2], 3))
    total = 0.5 * (total + total.T)
    if np.abs(total).max() > MAX_VARIANCE:
        variances, directions = np.linalg.eigh(total)
        total = (directions * np.clip(variances, 0.0, MAX_VARIANCE)) @ directions.T
        total = 0.5 * (total + total.T)
    return total + FLOOR


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
    steps = [
        motion_step(T_prev, T_cur, covariance, noise)
        for T_prev, T_cur, covariance in zip(T_odom_body[:-1], T_odom_body[1:], sent, strict=True)
    ]
    return compounded(steps, noise)
