"""Loop geometry through the bindings: arrays, typed results, errors; C++ tests hold the numbers."""

from __future__ import annotations

import threading

import covinz_core as core
import numpy as np
import pytest
from numpy.typing import NDArray

from covinz.frames import inverse, local_error, so3_exp, transform

Array = NDArray[np.float64]

FREIBURG1 = [517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633, 0.0, 0.0, 0.0]
T_CAND_QUERY = transform(so3_exp([0.1, -0.2, 0.05]), [0.4, -0.1, 0.2])


def rigs(num_query: int = 2, num_cand: int = 3) -> tuple[list[core.RigCamera], ...]:
    """Two rigs that see 300 points in front of the candidate's reference camera."""
    rng = np.random.default_rng(3)
    points_cand = rng.uniform([-2, -1.5, 3], [2, 1.5, 7], (300, 3))
    descriptors = rng.integers(0, 256, (300, 32), dtype=np.uint8)

    def rig(points_body: Array, count: int) -> list[core.RigCamera]:
        cameras = []
        for i in range(count):
            t = np.zeros(3) if i == 0 else rng.uniform(-0.3, 0.3, 3)
            T_body_cam = transform(so3_exp(rng.normal(scale=0.1 * (i > 0), size=3)), t)
            points_cam = (points_body - t) @ T_body_cam[:3, :3]
            points_cam += rng.normal(scale=1e-3, size=points_cam.shape)
            bearings = points_cam / np.linalg.norm(points_cam, axis=1, keepdims=True)
            cameras.append(core.RigCamera(T_body_cam, bearings, descriptors, 500.0))
        return cameras

    T_query_cand = inverse(T_CAND_QUERY)
    points_query = points_cand @ T_query_cand[:3, :3].T + T_query_cand[:3, 3]
    return rig(points_query, num_query), rig(points_cand, num_cand)


def test_bearings_project_back() -> None:
    pixels = np.stack(np.meshgrid(np.arange(0.0, 640, 20), np.arange(0.0, 480, 20)), -1)
    pixels = pixels.reshape(-1, 2)
    bearings = core.bearing_vectors("FULL_OPENCV", FREIBURG1, pixels)
    assert bearings.shape == (768, 3) and bearings.dtype == np.float64
    np.testing.assert_allclose(
        core.project_points("FULL_OPENCV", FREIBURG1, 3.0 * bearings), pixels, atol=1e-7
    )


@pytest.mark.parametrize(
    ("model", "params"),
    [("FISHEYE", [1.0] * 8), ("OPENCV", [1.0] * 4), ("PINHOLE", [1.0, np.nan, 0.0, 0.0])],
)
def test_a_bad_calibration_is_its_own_error(model: str, params: list[float]) -> None:
    with pytest.raises(core.InvalidCamera):
        core.bearing_vectors(model, params, np.zeros((1, 2)))
    assert issubclass(core.InvalidCamera, ValueError)


def test_a_loop_is_a_typed_value() -> None:
    query, cand = rigs()
    loop = core.solve_loop(query, cand, core.LoopOptions())
    assert isinstance(loop, core.LoopEstimate)
    error = local_error(T_CAND_QUERY, loop.T_cand_query)
    assert np.linalg.norm(error[:3]) < 0.02 and np.linalg.norm(error[3:]) < 0.1
    assert loop.covariance.shape == (6, 6)
    assert np.linalg.eigvalsh(loop.covariance).min() > 0
    assert len(loop.num_matches) == len(loop.num_pair_inliers) == 6
    assert loop.num_inliers >= 100


def test_a_rejection_is_a_typed_value() -> None:
    query, cand = rigs(1, 1)
    rejection = core.solve_loop(query, cand, core.LoopOptions())
    assert isinstance(rejection, core.LoopRejection)
    assert (rejection.stage, rejection.pair, rejection.count) == ("degenerate", None, 0.0)
    assert rejection.threshold == core.LoopOptions().min_baseline_m
    assert "degenerate" in repr(rejection)


def test_nested_options_are_set_in_place() -> None:
    query, cand = rigs()
    options = core.LoopOptions()
    options.matching.max_distance = 0.0
    options.matching.norm = core.DescriptorNorm.L2
    options.min_num_matches = 301
    rejection = core.solve_loop(query, cand, options)
    assert isinstance(rejection, core.LoopRejection)
    assert (rejection.stage, rejection.pair) == ("matches", 0)
    options.rig.confidence = 2.0
    with pytest.raises(ValueError, match="confidence"):
        options.check()
    with pytest.raises(ValueError, match="confidence"):
        core.solve_loop(query, cand, options)


def test_malformed_cameras_are_refused() -> None:
    bearings = np.tile([0.0, 0.0, 1.0], (5, 1))
    descriptors = np.zeros((5, 32), np.uint8)
    with pytest.raises(ValueError, match="descriptors"):
        core.RigCamera(np.eye(4), bearings, descriptors[:4], 500.0)
    with pytest.raises(ValueError, match="rigid"):
        core.RigCamera(2 * np.eye(4), bearings, descriptors, 500.0)
    with pytest.raises(ValueError, match="focal"):
        core.RigCamera(np.eye(4), bearings, descriptors, 0.0)
    with pytest.raises(ValueError, match="unit"):
        core.RigCamera(np.eye(4), 2 * bearings, descriptors, 500.0)


def test_other_threads_run_meanwhile() -> None:
    query, cand = rigs()
    options = core.LoopOptions()
    options.covariance.num_samples = options.covariance.max_num_tries = 8_000
    solver = threading.Thread(target=core.solve_loop, args=(query, cand, options))
    solver.start()
    turns = 0
    while solver.is_alive():
        turns += 1
        solver.join(0.001)
    # With the interpreter locked this thread would get its first turn at the end.
    assert turns > 20
