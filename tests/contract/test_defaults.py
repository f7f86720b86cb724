"""The defaults of the numeric core are those of covinz.config, wherever both have one."""

from __future__ import annotations

from typing import Any

import covinz_core
import numpy as np
import pytest

from covinz.config import (
    LoopSolverConfig,
    OdometryNoise,
    OptimizerConfig,
    PlaceRecognitionConfig,
)
from services.loop_solver.solver import fast_loop_options, loop_options


def fields(options: Any, prefix: str = "") -> dict[str, Any]:
    """Every field of an options object and of those in it, by its dotted name."""
    found: dict[str, Any] = {}
    for name in dir(options):
        value = getattr(options, name)
        if name.startswith("_") or callable(value):
            continue
        if type(value).__name__.endswith("Options"):
            found |= fields(value, f"{prefix}{name}.")
        else:
            found[prefix + name] = value
    return found


def test_loop_options() -> None:
    core = covinz_core.LoopOptions()
    assert fields(loop_options(LoopSolverConfig(profile="paper"), core.seed)) == fields(core)
    assert {"matching.max_ratio", "scale.max_error_px", "min_baseline_m"} < fields(core).keys()


def test_fast_loop_options() -> None:
    core = covinz_core.FastLoopOptions()
    assert fields(fast_loop_options(LoopSolverConfig(), core.seed)) == fields(core)
    assert {"matching.max_ratio", "hypotheses.max_error_px"} < fields(core).keys()


def test_a_loop_is_never_surer_than_an_odometry_edge() -> None:
    core, noise = covinz_core.LoopOptions().covariance, OdometryNoise()
    assert core.min_sigma_rotation_rad == noise.min_rotation
    assert core.min_sigma_translation_m == noise.min_translation


def test_pose_graph_options() -> None:
    core, ours = covinz_core.PoseGraphOptions(), OptimizerConfig()
    assert core.cauchy_scale == ours.cauchy_scale
    assert core.max_num_iterations == ours.max_iterations


@pytest.mark.parametrize(("further", "votes"), [(0, True), (1, False)])
def test_hamming_limit_of_the_index(further: int, votes: bool) -> None:
    bits = np.zeros((1, 256), dtype=np.uint8)
    index = covinz_core.InvertedIndex()
    for word in (0, 1):
        index.add(np.array([word], dtype=np.uint32), np.packbits(bits, axis=1))
    bits[0, : PlaceRecognitionConfig().max_hamming + further] = 1
    scores = index.votes(np.array([0], dtype=np.uint32), np.packbits(bits, axis=1))
    assert bool(scores[0] > 0) == votes
