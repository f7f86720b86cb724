"""The loops of a map: how far each is off the truth, and whether it bends the map.

A loop is wrong when it is off by more than `WRONG_M` or `WRONG_RAD`. The optimizer's robust loss
is there to silence wrong loops; whether it did can be measured in two ways:

- A wrong loop is *effective* when its weight in the optimised map (`robust_weights`) is above
  `EFFECTIVE_WEIGHT`. It need not do harm: a loop that says itself how uncertain it is keeps its
  weight and is outvoted.
- An effective wrong loop *bends* the map when the map, between the loop's two ends, went more than
  `BENT_SHARE` of the way from the truth to what the loop says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.evaluation import RelativeErrors
from covinz.types import Array, KeyframeId, MapSnapshot

# A loop is wrong when it is off by more than either.
WRONG_M = 0.3
WRONG_RAD = float(np.deg2rad(8.0))
# Half its full weight: the map passes within `cauchy_scale` sigmas of the loop.
EFFECTIVE_WEIGHT = 0.5
# Half way from the truth to the loop.
BENT_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LoopEdges:
    """The loop edges of one map.

    Attributes:
        cand: (L,) index of the candidate keyframe in the snapshot.
        query: (L,) index of the query keyframe.
        weights: (L,) in [0, 1]; see `robust_weights`.
        translation_m: (L,) error against the truth; NaN where an end has none.
        rotation_rad: (L,) likewise.
        followed_translation: (L,) how far the map went from the truth to the loop, as a share of
            the way: 0 at the truth, 1 at the loop; NaN where an end has no truth.
        followed_rotation: (L,) likewise.
    """

    cand: NDArray[np.int64]
    query: NDArray[np.int64]
    weights: Array
    translation_m: Array
    rotation_rad: Array
    followed_translation: Array
    followed_rotation: Array

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """(L,) loops that are off the truth by more than the limits; False without truth."""
        return beyond_limits(RelativeErrors(self.translation_m, self.rotation_rad))

    @property
    def effective(self) -> NDArray[np.bool_]:
        """(L,) wrong loops that the robust loss did not silence."""
        return np.asarray(self.wrong & (self.weights > EFFECTIVE_WEIGHT))

    @property
    def bending(self) -> NDArray[np.bool_]:
        """(L,) effective wrong loops that the map followed, in what is wrong about them."""
        far, turned = self.translation_m > WRONG_M, self.rotation_rad > WRONG_RAD
        followed = (far & (self.followed_translation > BENT_SHARE)) | (
            turned & (self.followed_rotation > BENT_SHARE)
        )
        return np.asarray(self.effective & followed)


def beyond_limits(errors: RelativeErrors) -> NDArray[np.bool_]:
    """Which errors of relative poses make a wrong loop; never those that are NaN."""
    return np.asarray((errors.translation_m > WRONG_M) | (errors.rotation_rad > WRONG_RAD))


def robust_weights(chi2: Array, cauchy_scale: float) -> Array:
    """Weights (L,) of loop edges in the optimised map: ``1 / (1 + chi2 / a^2)``.

    The derivative of the Cauchy loss, the factor by which it scales an edge's pull. 1: the map
    passes through the loop; 1/2: it misses it by `a` sigmas.

    Args:
        chi2: (L,) e^T W e of each edge at the optimised poses.
        cauchy_scale: a, in sigmas: `OptimizerConfig.cauchy_scale`.

    Source: paper III-C, equation (1); core/include/covinz/pose_graph.h.
    """
    return np.asarray(1.0 / (1.0 + chi2 / cauchy_scale**2))


def loop_edges(
    snapshot: MapSnapshot, true_poses: Mapping[KeyframeId, Array], cauchy_scale: float
) -> LoopEdges:
    """Measure the loop edges of a map; `true_poses` are T_world_body of keyframes that have one."""
    loops = np.flatnonzero(snapshot.is_loop)
    cand, query = snapshot.edge_from[loops], snapshot.edge_to[loops]
    T_loop = snapshot.T_from_to[loops]
    T_map = relative_poses(snapshot.T_map_body, cand, query)
    here = np.array([keyframe in true_poses for keyframe in snapshot.keyframes], dtype=bool)
    truth = np.array([true_poses.get(keyframe, np.eye(4)) for keyframe in snapshot.keyframes])
    known = here[cand] & here[query]
    T_true = relative_poses(truth, cand[known], query[known])
    of_loop = frames.local_error(T_true, T_loop[known])
    of_map = frames.local_error(T_true, T_map[known])
    turned, moved = slice(0, 3), slice(3, 6)
    return LoopEdges(
        cand,
        query,
        robust_weights(_chi2(T_loop, T_map, snapshot.information[loops]), cauchy_scale),
        _spread(np.linalg.norm(of_loop[:, moved], axis=1), known),
        _spread(np.linalg.norm(of_loop[:, turned], axis=1), known),
        _spread(_share(of_map[:, moved], of_loop[:, moved]), known),
        _spread(_share(of_map[:, turned], of_loop[:, turned]), known),
    )


def relative_poses(T_ref_body: Array, start: NDArray[np.int64], end: NDArray[np.int64]) -> Array:
    """Poses (K, 4, 4) of the bodies `end` in the bodies `start`."""
    return frames.inverse(T_ref_body[start]) @ T_ref_body[end]


def _chi2(T_measured: Array, T: Array, information: Array) -> Array:
    error = frames.local_error(T_measured, T)
    return np.asarray(np.einsum("li,lij,lj->l", error, information, error))


def _share(of_map: Array, of_loop: Array) -> Array:
    """Length of the map's errors (L, 3) along the loop's, in units of the loop's; 0 where none."""
    squared = np.sum(of_loop**2, axis=1)
    along = np.sum(of_map * of_loop, axis=1)
    return np.where(squared > 0, along / np.where(squared > 0, squared, 1.0), 0.0)


def _spread(values: Array, known: NDArray[np.bool_]) -> Array:
    """Values of the edges that have one at their places, NaN elsewhere."""
    column = np.full(len(known), np.nan)
    column[known] = values
    return column
