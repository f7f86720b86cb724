"""The generated loop problems are what they say: geometry, number and share of matches, seeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.loop_conditions import CONDITIONS
from benchmarks.loop_problems import FOCAL_PX, T_BODY_CAM, LoopProblem, View, generate
from covinz.frames import inverse, so3_log

Array = NDArray[np.float64]


def mutual_matches(query: View, cand: View) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of mutual nearest neighbours within 64 bits, by Hamming distances of all pairs."""
    a, b = (np.unpackbits(v.descriptors, axis=1).astype(np.float32) for v in (query, cand))
    distances = a.sum(1)[:, None] + b.sum(1)[None] - 2 * a @ b.T
    best = distances.argmin(1)
    rows = np.arange(len(a))
    mutual = (distances.argmin(0)[best] == rows) & (distances[rows, best] <= 64)
    return rows[mutual], best[mutual]


def pairs(problem: LoopProblem) -> Iterator[tuple[View, View, Array]]:
    """The six pairs of views with the true pose of the query camera in the candidate's."""
    for query, T_query_cam in zip(problem.query_views, problem.T_query_cam, strict=True):
        for cand, T_cand_cam in zip(problem.cand_views, problem.T_cand_cam, strict=True):
            T = inverse(T_cand_cam) @ problem.T_cand_query @ T_query_cam
            yield query, cand, T


@pytest.mark.parametrize("name", ["default", "outliers_60", "forward"])
def test_matches_are_as_many_and_as_wrong_as_stated(name: str) -> None:
    for seed in range(2):
        problem = generate(CONDITIONS[name], seed)
        total = right = 0
        for query, cand, _ in pairs(problem):
            rows_query, rows_cand = mutual_matches(query, cand)
            landmarks = query.landmarks[rows_query]
            total += len(rows_query)
            right += int(((landmarks == cand.landmarks[rows_cand]) & (landmarks >= 0)).sum())
        assert 850 <= total <= 1620
        assert 1 - right / total == pytest.approx(CONDITIONS[name].outlier_share, abs=0.03)


def test_without_noise_right_matches_lie_on_epipolar_lines_in_front() -> None:
    problem = generate(replace(CONDITIONS["default"], noise_px=0.0), 3)
    for query, cand, T_cand_query in pairs(problem):
        common, rows_query, rows_cand = np.intersect1d(
            query.landmarks, cand.landmarks, return_indices=True
        )
        seen = common >= 0
        assert seen.sum() > 30
        rays = query.bearings[rows_query[seen]] @ T_cand_query[:3, :3].T
        bearings = cand.bearings[rows_cand[seen]]
        normals = np.cross(T_cand_query[:3, 3], rays)
        assert np.abs((bearings * normals).sum(1)).max() < 1e-12
        # In front of both: the ray, moved along the translation, turns towards the bearing.
        assert ((np.cross(rays, bearings) * np.cross(rays, T_cand_query[:3, 3])).sum(1) > 0).all()


def test_noise_is_as_stated() -> None:
    condition = CONDITIONS["default"]
    noisy, exact = generate(condition, 1), generate(replace(condition, noise_px=0.0), 1)
    px = [
        FOCAL_PX * (a.bearings / a.bearings[:, 2:] - b.bearings / b.bearings[:, 2:])[:, :2]
        for a, b in zip(noisy.cand_views, exact.cand_views, strict=True)
    ]
    of_landmarks = np.concatenate(
        [d[v.landmarks >= 0] for d, v in zip(px, noisy.cand_views, strict=True)]
    )
    assert np.std(of_landmarks) == pytest.approx(1.0, abs=0.05)


def test_pure_rotation_has_one_body_centre_a_rig() -> None:
    problem = generate(CONDITIONS["pure_rotation"], 0)
    T_body_bodies = problem.T_cand_cam @ inverse(T_BODY_CAM)
    np.testing.assert_allclose(T_body_bodies[:, :3, 3], 0.0, atol=1e-12)
    assert min(np.linalg.norm(so3_log(T[:3, :3])) for T in T_body_bodies[1:]) > 0.01


def test_same_seed_same_arrays() -> None:
    a, b, c = (generate(CONDITIONS["default"], seed) for seed in (5, 5, 6))
    for view_a, view_b in zip(a.query_views, b.query_views, strict=True):
        np.testing.assert_array_equal(view_a.bearings, view_b.bearings)
        np.testing.assert_array_equal(view_a.descriptors, view_b.descriptors)
    np.testing.assert_array_equal(a.T_cand_query, b.T_cand_query)
    assert not np.array_equal(a.T_cand_query, c.T_cand_query)
