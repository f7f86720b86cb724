"""The PnP baseline finds the pose of a camera among points that exact odometry triangulates."""

from __future__ import annotations

from dataclasses import replace

import covinz_core as core
import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.loop_figures import NoPose, Pose
from benchmarks.pnp_baseline import Image, solve_pnp, triangulate
from covinz.frames import inverse, local_error, so3_exp, transform

Array = NDArray[np.float64]

FOCAL_PX = 400.0
MAX_ERROR_PX = 3.0
T_BODY_CAM = transform(so3_exp([0.1, -0.2, 1.4]), [0.05, 0.02, -0.01])
T_CAND_QUERY = transform(so3_exp([0.05, -0.1, 0.08]), [0.3, -0.2, 0.15])
# Bodies of the candidate's rig.
STEPS = [np.eye(4), *(transform(so3_exp([0, 0.02 * s, 0]), [0.3 * s, 0.1, 0.05]) for s in (1, -1))]


def image(T_rig_body: Array, points: Array, descriptors: NDArray[np.uint8]) -> Image:
    T_rig_cam = T_rig_body @ T_BODY_CAM
    T_cam_rig = inverse(T_rig_cam)
    rays = points @ T_cam_rig[:3, :3].T + T_cam_rig[:3, 3]
    bearings = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return Image(T_rig_cam, T_BODY_CAM, bearings, descriptors, FOCAL_PX)


def scene(count: int) -> tuple[Image, list[Image], Array]:
    """The query's image, the candidate's, and the points in the candidate's body frame."""
    rng = np.random.default_rng(1)
    in_camera = rng.uniform([-1.5, -1.5, 3.0], [1.5, 1.5, 8.0], (count, 3))
    points = in_camera @ T_BODY_CAM[:3, :3].T + T_BODY_CAM[:3, 3]
    descriptors = rng.integers(0, 256, (count, 32), dtype=np.uint8)
    query = replace(image(T_CAND_QUERY, points, descriptors), T_rig_cam=T_BODY_CAM)
    return query, [image(T, points, descriptors) for T in STEPS], points


def test_exact_data_give_the_true_pose() -> None:
    query, cand, _ = scene(80)
    found = solve_pnp(query, cand, core.MatchingOptions(), MAX_ERROR_PX)
    assert isinstance(found, Pose)
    assert np.abs(local_error(T_CAND_QUERY, found.T_cand_query)).max() < 1e-5


def test_few_points_are_no_loop() -> None:
    query, cand, _ = scene(39)
    assert solve_pnp(query, cand, core.MatchingOptions(), MAX_ERROR_PX) == NoPose("matches")


def test_wrong_matches_are_left_out() -> None:
    query, cand, _ = scene(120)
    mixed = query.bearings.copy()
    mixed[:30] = np.roll(mixed[:30], 1, axis=0)
    found = solve_pnp(replace(query, bearings=mixed), cand, core.MatchingOptions(), MAX_ERROR_PX)
    assert isinstance(found, Pose)
    assert np.abs(local_error(T_CAND_QUERY, found.T_cand_query)).max() < 1e-5


def test_another_place_is_no_loop() -> None:
    query, cand, _ = scene(80)
    shuffled = np.random.default_rng(2).permutation(query.bearings)
    assert solve_pnp(
        replace(query, bearings=shuffled), cand, core.MatchingOptions(), MAX_ERROR_PX
    ) == NoPose("rig_inliers")


def test_points_are_triangulated_where_they_are() -> None:
    _, cand, points = scene(20)
    rows = np.column_stack([np.arange(20), np.arange(20)])
    found, angles_rad = triangulate(cand[0], cand[1], rows, 2.0)
    np.testing.assert_allclose(found, points, atol=1e-9)
    rays = points - cand[0].T_rig_cam[:3, 3], points - cand[1].T_rig_cam[:3, 3]
    cosine = (rays[0] * rays[1]).sum(1) / np.prod([np.linalg.norm(r, axis=1) for r in rays], axis=0)
    np.testing.assert_allclose(angles_rad, np.arccos(cosine), atol=1e-7)


@pytest.mark.parametrize("max_error_px", [2.0, 10.0])
def test_rays_that_miss_each_other_are_no_point(max_error_px: float) -> None:
    _, cand, _ = scene(20)
    rows = np.column_stack([np.arange(20), np.roll(np.arange(20), 1)])
    found, _ = triangulate(cand[0], cand[1], rows, max_error_px)
    assert np.isnan(found[:, 0]).sum() >= 15
