"""The benchmark of generated loops: its keys, and that its peer is asked what it is meant to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.loop_conditions import CONDITIONS
from benchmarks.loop_figures import Pose
from benchmarks.loop_peers import solve_poselib
from benchmarks.loop_problems import generate
from benchmarks.loop_synthetic import METHODS, measure
from covinz.frames import local_error

# What others read.
KEYS = {
    "success", "t_err_median_m", "t_err_p95_m", "r_err_median_deg", "nees_mean", "nees_over_22_5",
    "ms_median", "ms_p95",
}  # fmt: skip
SPEEDUPS = (
    "speedup_median", "speedup_portable_median", "speedup_no_popcnt_median",
    "speedup_geometry_only_median",
)  # fmt: skip


def test_every_key_is_there() -> None:
    made = measure(["default", "pure_rotation"], list(METHODS), trials=2)
    for condition in ("default", "pure_rotation"):
        assert {"paper", "fast", "poselib"} <= made["conditions"][condition].keys()
        for figures in made["conditions"][condition].values():
            assert figures.keys() >= KEYS
            assert figures["trials"] == 2
            assert figures["accepted"] + sum(figures["rejected"].values()) == 2
    assert all(made[key] > 1 for key in SPEEDUPS)
    assert isinstance(made["isa"], str)
    fast = made["conditions"]["default"]["fast"]
    assert fast["success"] == fast["success_of_all"] == 1.0
    assert made["conditions"]["default"]["poselib"]["nees_mean"] is None


def test_without_the_condition_of_the_claim_there_is_no_speedup() -> None:
    made = measure(["forward"], ["fast"], trials=1)
    assert [made[key] for key in SPEEDUPS] == [None] * 4


def test_exact_data_give_the_true_pose_by_poselib() -> None:
    exact = replace(
        CONDITIONS["default"], noise_px=0.0, odometry_sigma_m=0.0, odometry_sigma_rad=0.0
    )
    problem = generate(exact, 1)
    np.testing.assert_allclose(problem.T_query_cam_odometry, problem.T_query_cam, atol=1e-12)
    found = solve_poselib(problem, seed=0)
    assert isinstance(found, Pose)
    assert np.abs(local_error(problem.T_cand_query, found.T_cand_query)).max() == pytest.approx(
        0.0, abs=1e-3
    )
