"""Figures of merit against ground truth: alignment, ATE, RPE, NEES, errors of loops.

Only numpy. Trajectories are associated by time stamp with ground truth interpolated over a
bounded gap; alignment is rigid, without scale, since every map of covinz is metric.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from covinz import frames
from covinz.trajectory import Trajectory
from covinz.types import Array, frozen_array

# Ground truth of the data sets comes at 20 to 100 Hz; a longer gap is a hole in the recording.
MAX_GAP_NS = 100_000_000


@dataclass(frozen=True, slots=True, eq=False)
class PosePairs:
    """Estimated poses with the true pose at the same time.

    Attributes:
        stamps_ns: (N,) int64, ascending.
        T_est_body: (N, 4, 4) in the frame of the estimate (``map`` or ``odom``).
        T_ref_body: (N, 4, 4) in the frame of the ground truth.
    """

    stamps_ns: NDArray[np.int64]
    T_est_body: Array
    T_ref_body: Array

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        object.__setattr__(self, "stamps_ns", frozen_array(self.stamps_ns, (n,), "i8"))
        for name in ("T_est_body", "T_ref_body"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n, 4, 4)))

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, slots=True, eq=False)
class RelativeErrors:
    """Errors of relative poses: (K,) translation [m] and rotation [rad]."""

    translation_m: Array
    rotation_rad: Array


def associate(
    estimate: Trajectory, groundtruth: Trajectory, max_gap_ns: int = MAX_GAP_NS
) -> PosePairs:
    """Pair every estimated pose with the ground truth at its time.

    Estimated poses outside the ground truth, or in a gap of it longer than `max_gap_ns`, are
    left out.
    """
    T_ref_body, found = groundtruth.sample(estimate.stamps_ns, max_gap_ns)
    return PosePairs(estimate.stamps_ns[found], estimate.T_ref_body[found], T_ref_body)


def align(points_est: ArrayLike, points_ref: ArrayLike) -> Array:
    """Rigid T_ref_est (4, 4) that minimises the squared distances between two point lists.

    Degenerate input still gives a minimiser, though not the only one: one point gives the
    identity rotation; for collinear points the angle about their line is arbitrary.

    Args:
        points_est: (N, 3) points.
        points_ref: (N, 3) the same points in the other frame.

    Raises:
        ValueError: If there is no point, or the shapes differ.

    Source: Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns", TPAMI 1991, with scale 1.
    """
    est, ref = np.asarray(points_est, dtype=float), np.asarray(points_ref, dtype=float)
    if est.shape != ref.shape or est.ndim != 2 or est.shape[1:] != (3,) or len(est) == 0:
        raise ValueError(f"cannot align points of shapes {est.shape} and {ref.shape}")
    mean_est, mean_ref = est.mean(axis=0), ref.mean(axis=0)
    covariance = (ref - mean_ref).T @ (est - mean_est) / len(est)
    if not np.abs(covariance).max() > 0:
        return frames.transform(np.eye(3), mean_ref - mean_est)
    U, _, Vt = np.linalg.svd(covariance)
    sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    R = U @ np.diag([1.0, 1.0, sign]) @ Vt
    return frames.transform(R, mean_ref - R @ mean_est)


def position_errors(pairs: PosePairs, T_ref_est: Array) -> Array:
    """Distances (N,) [m] of the estimated positions from the true ones under an alignment."""
    aligned = T_ref_est @ pairs.T_est_body
    errors: Array = np.linalg.norm(aligned[:, :3, 3] - pairs.T_ref_body[:, :3, 3], axis=-1)
    return errors


def alignment(pairs: Iterable[PosePairs]) -> Array:
    """One T_ref_est (4, 4) for the positions of several trajectories; see `align`."""
    listed = list(pairs)
    return align(
        np.concatenate([p.T_est_body[:, :3, 3] for p in listed] or [np.empty((0, 3))]),
        np.concatenate([p.T_ref_body[:, :3, 3] for p in listed] or [np.empty((0, 3))]),
    )


def ate_m(pairs: PosePairs) -> float:
    """Absolute trajectory error: RMSE of the positions after `align` [m].

    Raises:
        ValueError: If `pairs` is empty.

    Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012.
    """
    return rmse(position_errors(pairs, alignment([pairs])))


def joint_ate_m(trajectories: Sequence[PosePairs]) -> float:
    """ATE of several agents in one map: one alignment for all, errors pooled [m].

    Raises:
        ValueError: If there is no pose at all.

    Source: paper IV-B.
    """
    T_ref_est = alignment(trajectories)
    return rmse(np.concatenate([position_errors(p, T_ref_est) for p in trajectories]))


def separate_ate_m(trajectories: Sequence[PosePairs]) -> float:
    """ATE with every agent aligned on its own, errors pooled over all poses [m].

    Raises:
        ValueError: If there is no pose at all.
    """
    aligned = [position_errors(p, alignment([p])) for p in trajectories if len(p)]
    return rmse(np.concatenate([*aligned, np.empty(0)]))


def rmse(errors: ArrayLike) -> float:
    """Root of the mean square; raises ValueError when there is nothing to average."""
    values = np.asarray(errors, dtype=float)
    if values.size == 0:
        raise ValueError("no errors to average: no pose has ground truth")
    return float(np.sqrt(np.mean(values**2)))


def rpe_over_distance(pairs: PosePairs, delta_m: float) -> RelativeErrors:
    """Relative pose errors over a distance along the true path; no alignment is needed.

    Every pose with the first later one that is at least `delta_m` further gives one error.

    Raises:
        ValueError: If the distance is not positive.

    Source: Geiger et al., "Are we ready for autonomous driving?", CVPR 2012.
    """
    if not delta_m > 0:
        raise ValueError(f"the distance must be positive, got {delta_m}")
    steps = np.linalg.norm(np.diff(pairs.T_ref_body[:, :3, 3], axis=0), axis=-1)
    path_m = np.concatenate([[0.0], np.cumsum(steps)])[: len(pairs)]
    # A whole number of equal steps must not miss its end by rounding.
    return _rpe(pairs, np.searchsorted(path_m, path_m + delta_m * (1 - 1e-9)))


def rpe_over_time(pairs: PosePairs, delta_ns: int) -> RelativeErrors:
    """Relative pose errors over a time: as `rpe_over_distance`, at least `delta_ns` later.

    Raises:
        ValueError: If the time is not positive.

    Source: Sturm et al., IROS 2012.
    """
    if not delta_ns > 0:
        raise ValueError(f"the time must be positive, got {delta_ns}")
    return _rpe(pairs, np.searchsorted(pairs.stamps_ns, pairs.stamps_ns + delta_ns))


def _rpe(pairs: PosePairs, end: NDArray[np.intp]) -> RelativeErrors:
    start = np.flatnonzero(end < len(pairs))
    T_true, T_est = (
        frames.inverse(T[start]) @ T[end[start]] for T in (pairs.T_ref_body, pairs.T_est_body)
    )
    return relative_errors(T_true, T_est)


def relative_errors(T_true: Array, T_est: Array) -> RelativeErrors:
    """Errors of relative poses (..., 4, 4), e.g. of loops' ``T_cand_query``.

    Translation: distance between the two translations; rotation: angle between the rotations.
    """
    error = frames.local_error(T_true, T_est)
    return RelativeErrors(
        np.linalg.norm(error[..., 3:], axis=-1), np.linalg.norm(error[..., :3], axis=-1)
    )


def true_loops(T_world_cand: Array, T_world_query: Array) -> Array:
    """True ``T_cand_query`` (..., 4, 4) of bodies whose true poses are known."""
    return frames.inverse(T_world_cand) @ T_world_query


def nees(T_true: Array, T_est: Array, covariance: ArrayLike) -> Array:
    """Normalised estimation error squared (...,): ``e^T inv(covariance) e``.

    e is the right perturbation [rotation (rad), translation (m)] that takes the estimate to the
    truth, in the estimate's moving frame (for a loop: the query body), the frame of the
    covariance. An honest covariance of a normal error gives 6 on average; above: too small.

    Args:
        T_true: (..., 4, 4).
        T_est: (..., 4, 4).
        covariance: (..., 6, 6), symmetric positive definite.

    Raises:
        numpy.linalg.LinAlgError: If a covariance is not positive definite.

    Source: Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and
    navigation", 2001, 5.4.2.
    """
    error = frames.local_error(T_est, T_true)
    lower = np.linalg.cholesky(np.asarray(covariance, dtype=float))
    whitened = np.linalg.solve(lower, error[..., None])[..., 0]
    return np.asarray(np.sum(whitened**2, axis=-1))
