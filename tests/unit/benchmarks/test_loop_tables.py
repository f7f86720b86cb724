"""The tables of the loop benchmarks show what the reports say, also what is missing in them."""

from __future__ import annotations

import copy
from typing import Any

from benchmarks.loop_tables import (
    accuracy_section,
    brief,
    merged,
    synthetic_section,
    traffic_section,
)
from benchmarks.runtime_traffic import PUBLISHED

METHOD: dict[str, Any] = {
    "trials": 100, "accepted": 98, "rejected": {"matches": 2}, "success": 0.987,
    "success_of_all": 0.97, "t_err_median_m": 0.0123, "t_err_p95_m": 0.0456,
    "r_err_median_deg": 0.051, "r_err_p95_deg": 0.123, "nees_mean": 5.43, "nees_median": 4.0,
    "nees_over_22_5": 0.011, "ms_median": 6.54, "ms_p95": 9.87,
    "stage_ms_mean": {"matching": 57.4},
}  # fmt: skip
NOTHING = METHOD | {
    "accepted": 0, "rejected": {"uncertainty": 100}, "success": None, "t_err_median_m": None,
    "t_err_p95_m": None, "r_err_median_deg": None, "r_err_p95_deg": None, "nees_mean": None,
    "nees_median": None, "nees_over_22_5": None,
}  # fmt: skip
SYNTHETIC: dict[str, Any] = {
    "trials": 100, "isa": "avx512", "speedup_median": 16.13, "speedup_portable_median": 8.9,
    "speedup_no_popcnt_median": 3.3, "speedup_portable_older_cpu_median": 9.9,
    "speedup_geometry_only_median": None,
    "conditions": {
        "default": {"paper": METHOD | {"ms_median": 77.7}, "fast": METHOD, "poselib": METHOD},
        "pure_rotation": {"fast": NOTHING},
    },
}  # fmt: skip
ATTEMPTS = METHOD | {
    "jobs": 263, "wrong": 3, "estimated": 261, "within_nees_22_5": 177, "beyond_nees_22_5": 4,
    "nees_mean_without_truth": 121.5, "nees_analytic_mean": 456.7,
    "nees_analytic_mean_without_truth": 789.0,
}  # fmt: skip
ACCURACY: dict[str, Any] = {
    "fast_over_paper": {"redkitchen": {"jobs": 263, "accepted": 2.83, "speedup_median": 6.61}},
    "redkitchen": {name: ATTEMPTS for name in ("paper", "fast", "pnp")},
    "fr1_rpy": {"fast": ATTEMPTS},
}


def test_generated_loops_are_all_there() -> None:
    text = synthetic_section(SYNTHETIC)
    assert (
        "| 98.7 % | matches 2 | 0.012 m, 0.05° | 0.046 m, 0.12° | 5.4 | 1.1 % | 6.5 / 9.9 ms |"
        in text
    )
    assert "| - | uncertainty 100 | - | - | - | - | 6.5 / 9.9 ms |" in text
    assert "`paper` takes 78 ms, of which 57 ms are matching" in text
    assert "16.1 times as fast as `paper`" in text
    assert "8.9 times with SSE4.2 and POPCNT alone (9.9 times where `paper` has no AVX2" in text
    assert "3.3 times without POPCNT" in text


def test_loops_of_images_are_all_there() -> None:
    text = accuracy_section(ACCURACY)
    row = "| 98 | 3 | 0.012 m, 0.05° | 5.4 | 456.7 | 1.1 % | 6.5 / 9.9 ms |"
    assert text.count(row) == 4
    assert "2.8 loops for each one of `paper`, 6.6 times as fast" in text
    assert (
        "without that the mean of `fast` is 121.5, and of its inverse Hessian alone 789.0" in text
    )
    assert "of 263 attempts 261 reach estimation" in text


def test_a_recording_that_is_not_there_is_not_written_about() -> None:
    without = copy.deepcopy(ACCURACY)
    del without["redkitchen"], without["fast_over_paper"]["redkitchen"]
    text = accuracy_section(without)
    assert "redkitchen" not in text
    assert "fr1_rpy" in text


def test_the_paper_s_own_figures_stand_beside_ours() -> None:
    run = {
        "candidates": 532, "loops": 268, "wrong": 1, "kB_per_s_per_agent": 41.2,
        "loop_ms_mean": 80.1, "loop_ms_std": 20.2, "attempt_ms_mean": 60.3, "attempt_ms_std": 30.4,
        "attempt_stage_ms_mean": {"matching": 1.234, "rig": 5.6},
    }  # fmt: skip
    report = {"published": PUBLISHED, "scenarios": {"hall": {"paper": run, "fast": run}}}
    text = traffic_section(report)
    assert "| 268 / 532 | 1 | 80.1 ± 20.2 ms | 60.3 ± 30.4 ms | 41 kB/s |" in text
    assert "| COVINS-G, as published |  | 75 | - | 213.0 ± 171.0 ms | - | 180 kB/s |" in text
    assert "| hall | `paper` | 1.23 ms | 5.60 ms |" in text


def test_the_readme_has_paper_fast_and_a_peer_side_by_side() -> None:
    text = brief(SYNTHETIC, ACCURACY)
    assert (
        "| the same: CPU time, median / p95 | 77.7 / 9.9 ms | 6.5 / 9.9 ms | 6.5 / 9.9 ms |" in text
    )
    assert "| 98 (3) of 263 | 98 (3) of 263 | 98 (3) of 263 |" in text
    assert "generated hall" not in text


def test_a_first_cell_is_not_repeated() -> None:
    assert merged([["a", "1"], ["a", "2"], ["b", "3"], ["a", "4"]]) == [
        ["a", "1"], ["", "2"], ["b", "3"], ["a", "4"],
    ]  # fmt: skip
