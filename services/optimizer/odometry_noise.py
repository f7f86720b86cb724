"""How far odometry can be trusted: covariances of single steps, composed over several.

A step is the motion between two keyframes that follow one another in a segment. Covariances are of
the right perturbation [rotation (rad), translation (m)], in the frame of the later body.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from covinz.config import OdometryNoise
from covinz.frames import Array, adjoint, inverse, rotation_angle
from services.optimizer.segments import Segment

# An agent that knows nothing says so with a huge covariance. Beyond this variance of a step
# (100 rad, 100 m) the edge no longer matters and only the conditioning of its inverse suffers.
MAX_STEP_VARIANCE = 1e4


def step_covariances(segment: Segment, noise: OdometryNoise) -> Array:
    """(N - 1, 6, 6) covariance of every step of a segment.

    The agent's own covariance where it sent a usable one (symmetric, positive semi-definite);
    otherwise a random walk: variances that grow with the metres travelled and the radians turned.
    A step over missing keyframes has no covariance of the agent's (that speaks of the motion since
    seq - 1 only): there both are added, the safe side.

    Source: paper III-C, "the expected accuracy of the corresponding front-end".
    """
    T_prev_cur = inverse(segment.T_odom_body[:-1]) @ segment.T_odom_body[1:]
    metres = np.linalg.norm(T_prev_cur[:, :3, 3], axis=1)
    radians = rotation_angle(T_prev_cur)
    rotation = noise.rotation_per_sqrt_m**2 * metres + noise.rotation_per_sqrt_rad**2 * radians
    translation = (
        noise.translation_per_sqrt_m**2 * metres + noise.translation_per_sqrt_rad**2 * radians
    )
    walk = np.zeros((len(T_prev_cur), 6, 6))
    walk[:, (0, 1, 2), (0, 1, 2)] = rotation[:, None]
    walk[:, (3, 4, 5), (3, 4, 5)] = translation[:, None]
    sent = segment.covariance[1:]
    usable = _usable(sent)
    largest = np.abs(np.where(usable[:, None, None], sent, 0.0)).max(axis=(1, 2), initial=0.0)
    sent = sent * (MAX_STEP_VARIANCE / np.maximum(largest, MAX_STEP_VARIANCE))[:, None, None]
    adjacent = usable & (np.diff(segment.seq) == 1)
    covariance = walk + np.where(usable[:, None, None], sent, 0.0)
    covariance[adjacent] = sent[adjacent]
    return 0.5 * (covariance + covariance.swapaxes(1, 2))


def composed(T_prev_cur: Array, step: Array, num_steps: int) -> Array:
    """(N - num_steps + 1, 6, 6) covariance of every run of `num_steps` consecutive steps.

    Args:
        T_prev_cur: (N, 4, 4) motion of each step.
        step: (N, 6, 6) covariance of each step.
        num_steps: Length of a run, at least 1.

    An error before a step is seen from behind it through the adjoint of the step backwards:
    ``S <- A S A^T + Q`` with ``A = adjoint(T_cur_prev)``.

    Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships", 1990
    (compounding), for the right perturbation.
    """
    back = adjoint(inverse(T_prev_cur))
    total = step
    for done in range(1, num_steps):
        A = back[done:]
        total = A @ total[: len(A)] @ A.swapaxes(1, 2) + step[done:]
    return total


def bounded(covariance: Array) -> Array:
    """(N, 6, 6) with no variance above `MAX_STEP_VARIANCE` in any direction.

    Motions of kilometres (an odometry that blew up) are levers that make covariances of which
    nothing is left after rounding. Covariances without such entries are returned as they are.
    """
    result = covariance.copy()
    huge = np.abs(covariance).max(axis=(1, 2), initial=0.0) > MAX_STEP_VARIANCE
    variances, directions = np.linalg.eigh(covariance[huge])
    limited = np.clip(variances, 0.0, MAX_STEP_VARIANCE)
    result[huge] = (directions * limited[:, None, :]) @ directions.swapaxes(1, 2)
    return result


def floor_covariance(noise: OdometryNoise) -> Array:
    """(6, 6) added to every odometry edge: nothing is measured better than this."""
    return np.diag(np.repeat([noise.min_rotation**2, noise.min_translation**2], 3))


def edge_shares(num_keyframes: int, num_neighbours: int) -> list[Array]:
    """Factors on the information of the edges over 1, 2, .. `num_neighbours` steps.

    The paper's edges k -> k + l reuse the same odometry: taken as independent, every step would
    be counted by all edges that run over it (10 for q = 4) and odometry would be trusted
    sqrt(10) times too much against the loops. An edge over l steps with l times the variance
    pulls on each of its steps as much as an edge over that step alone; so each step is shared
    equally among the edges over it, and the information of the whole chain is again that of the
    odometry it was made from. Within the window the edges still keep neighbouring steps
    consistent, which is what the paper wants of them.

    Returns:
        Element l - 1 has shape (num_keyframes - l,): the edges from rows 0, 1, .. to row + l.

    Source: decision 0003; paper III-C, q = 4.
    """
    num_steps = max(num_keyframes - 1, 0)
    spans = range(1, min(num_neighbours, num_steps) + 1)
    edges_over = np.zeros(num_steps)
    for span in spans:
        edges_over += np.convolve(np.ones(num_steps - span + 1), np.ones(span))
    share_before = np.concatenate([[0.0], np.cumsum(1.0 / np.maximum(edges_over, 1.0))])
    return [(share_before[span:] - share_before[:-span]) / span for span in spans]


def _usable(covariance: Array) -> NDArray[np.bool_]:
    """(N,) bool: finite, symmetric and positive semi-definite within rounding."""
    finite: NDArray[np.bool_] = np.all(np.isfinite(covariance), axis=(1, 2))
    matrix = np.where(finite[:, None, None], covariance, np.eye(6))
    size = np.abs(matrix).max(axis=(1, 2))
    symmetric = np.abs(matrix - matrix.swapaxes(1, 2)).max(axis=(1, 2)) <= 1e-6 * size
    smallest = np.linalg.eigvalsh(0.5 * (matrix + matrix.swapaxes(1, 2)))[:, 0]
    usable: NDArray[np.bool_] = finite & symmetric & (smallest >= -1e-9 * size)
    return usable
