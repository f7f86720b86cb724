"""The benchmark of loops of images: its keys, and what it counts."""

from __future__ import annotations

from pathlib import Path

import covinz_core as core
import numpy as np

from benchmarks.fleet import Fleet
from benchmarks.loop_accuracy import METHODS, compared, figures, measure, solve_all
from benchmarks.loop_attempts import Attempts, chosen
from benchmarks.loop_conditions import CONDITIONS
from benchmarks.loop_figures import Limits, NoPose, Tally, Timed
from benchmarks.loop_jobs import near_pairs
from benchmarks.loop_problems import generate
from benchmarks.loop_synthetic import fast

KEYS = {
    "jobs", "accepted", "wrong", "t_err_median_m", "r_err_median_deg", "nees_mean", "ms_median",
    "estimated", "within_nees_22_5", "beyond_nees_22_5", "nees_analytic_mean",
}  # fmt: skip
LIMITS = Limits(0.3, np.deg2rad(8))


def rejected(ms: float) -> Timed:
    return Timed(NoPose("matches"), ms, {})


def test_every_method_makes_every_attempt(fleet: Fleet) -> None:
    pairs = near_pairs(fleet)
    attempts = Attempts(fleet, chosen(fleet, pairs), LIMITS)
    tallies, turns = solve_all(attempts, METHODS)
    assert len(turns) == len(pairs)
    for tally in tallies.values():
        made = figures(tally, attempts)
        assert made.keys() >= KEYS
        # Images of noise have no matches.
        assert made["jobs"] == sum(made["rejected"].values()) == len(pairs)
        assert made["accepted"] == made["estimated"] == 0
        assert made["ms_median"] > 0
    assert compared(turns)["jobs"] == len(pairs)
    assert compared(turns)["accepted"] is None


def test_fast_is_compared_on_what_both_did(fleet: Fleet) -> None:
    condition = CONDITIONS["default"]
    loop = Timed(fast(generate(condition, 0), condition, 0), 1.0, {})
    assert isinstance(loop.result, core.LoopEstimate)
    both = {"paper": Timed(loop.result, 12.0, {}), "fast": loop}
    turns = [both, {"paper": rejected(8.0), "fast": loop}, {"fast": loop}]
    assert compared(turns) == {"jobs": 2, "accepted": 2.0, "speedup_median": 10.0}


def test_a_loop_has_its_figures(fleet: Fleet) -> None:
    condition = CONDITIONS["default"]
    problem = generate(condition, 0)
    tally = Tally()
    tally.add(problem.T_cand_query, Timed(fast(problem, condition, 0), 1.0, {}))
    tally.add(problem.T_cand_query, Timed(NoPose("ambiguous"), 1.0, {}))
    tally.add(problem.T_cand_query, rejected(1.0))
    exact = figures(tally, Attempts(fleet, {}, LIMITS))
    assert (exact["jobs"], exact["accepted"], exact["wrong"], exact["estimated"]) == (3, 1, 0, 2)
    assert (exact["within_nees_22_5"], exact["beyond_nees_22_5"]) == (1, 0)
    assert exact["nees_mean"] == exact["nees_mean_without_truth"]
    uncertain = figures(tally, Attempts(fleet, {}, LIMITS, np.eye(6)))
    assert uncertain["nees_mean"] < exact["nees_mean"]
    assert uncertain["nees_mean_without_truth"] == exact["nees_mean"]


def test_a_recording_that_is_not_there_is_left_out(tmp_path: Path) -> None:
    made = measure(tmp_path, ["redkitchen", "elsewhere", "fr1_rpy"], METHODS)
    assert not made.keys() & {"redkitchen", "elsewhere", "fr1_rpy"}
    assert made["fast_over_paper"] == {}
