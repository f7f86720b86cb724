"""Other people's way from the same matches to a loop: PoseLib, for comparison in benchmarks only.

`estimate_generalized_relative_pose` is a 5+1-point LO-RANSAC with a non-linear refinement of the
relative pose; it takes the rigs as rigid and has no covariance. Its matches are those of profile
`fast`, made in the same way and counted in its time.

Source: Larsson et al., PoseLib 2.0.5, BSD-3, https://github.com/PoseLib/PoseLib.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import covinz_core as core
import numpy as np
import poselib  # type: ignore[import-untyped]

from benchmarks.loop_figures import NoPose, Pose, Result
from benchmarks.loop_problems import FOCAL_PX, Array, LoopProblem, View
from covinz import frames
from covinz.config import LoopSolverConfig
from services.loop_solver.solver import fast_loop_options

# The camera of the problems, its principal point at the origin.
_CAMERA = {"model": "PINHOLE", "width": 2, "height": 2, "params": [FOCAL_PX, FOCAL_PX, 0.0, 0.0]}


def solve_poselib(problem: LoopProblem, seed: int) -> Result:
    """A loop by PoseLib: its defaults but for the threshold, and 100 inliers at least."""
    config = LoopSolverConfig()
    begin = time.perf_counter()
    found = list(_matches(problem, fast_loop_options(config, seed).matching))
    matched_ms = 1e3 * (time.perf_counter() - begin)
    pose, info = poselib.estimate_generalized_relative_pose(
        found,
        [_extrinsics(T) for T in problem.T_query_cam_odometry],
        [_CAMERA] * len(problem.query_views),
        [_extrinsics(T) for T in problem.T_cand_cam_odometry],
        [_CAMERA] * len(problem.cand_views),
        {"max_epipolar_error": config.max_error_px, "seed": seed},
        {},
    )
    stages = [("matching", matched_ms), ("rig", 1e3 * (time.perf_counter() - begin) - matched_ms)]
    if info["num_inliers"] < config.min_rig_inliers:
        return NoPose("rig_inliers", stages)
    T_cand_query = np.eye(4)
    T_cand_query[:3] = pose.Rt
    return Pose(T_cand_query, stages)


def _matches(
    problem: LoopProblem, options: core.MatchingOptions
) -> Iterator[poselib.PairwiseMatches]:
    """Of all pairs, in pixels of the camera."""
    query, cand = (_packed(views) for views in (problem.query_views, problem.cand_views))
    pixels = [_pixels(view) for view in (*problem.query_views, *problem.cand_views)]
    for q, query_descriptors in enumerate(query):
        for c, cand_descriptors in enumerate(cand):
            rows = core.match_packed(query_descriptors, cand_descriptors, options)
            pair = poselib.PairwiseMatches()
            pair.cam_id1, pair.cam_id2 = q, c
            pair.x1, pair.x2 = pixels[q][rows[:, 0]], pixels[len(query) + c][rows[:, 1]]
            yield pair


def _packed(views: Sequence[View]) -> list[core.PackedDescriptors]:
    return [core.PackedDescriptors(view.descriptors) for view in views]


def _pixels(view: View) -> Array:
    pixels: Array = FOCAL_PX * view.bearings[:, :2] / view.bearings[:, 2:]
    return pixels


def _extrinsics(T_rig_cam: Array) -> poselib.CameraPose:
    """PoseLib's cameras map the rig into the camera."""
    pose = poselib.CameraPose()
    pose.Rt = frames.inverse(T_rig_cam)[:3]
    return pose
