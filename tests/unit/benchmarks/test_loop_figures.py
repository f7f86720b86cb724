"""Figures of loop attempts: against errors, covariances and times that are known."""

from __future__ import annotations

import covinz_core as core
import numpy as np
import pytest

from benchmarks.loop_figures import (
    Limits,
    NoPose,
    Pose,
    Tally,
    Timed,
    error_figures,
    nees_figures,
    rounded,
    stage_figures,
    time_figures,
    timed,
)
from covinz.frames import so3_exp, transform

TRUTH = transform(so3_exp([0.2, -0.1, 0.3]), [1.0, 2.0, 3.0])


def off_by(metres: float, radians: float) -> Pose:
    return Pose(TRUTH @ transform(so3_exp([0, 0, radians]), [metres, 0, 0]))


def tally(*poses: Pose) -> Tally:
    made = Tally()
    for pose in poses:
        made.add(TRUTH, Timed(pose, 1.0, {}))
    return made


def test_errors_are_those_of_the_poses() -> None:
    figures = error_figures(tally(off_by(0.1, 0.01), off_by(0.2, 0.02), off_by(0.6, 0.3)))
    assert figures["t_err_median_m"] == pytest.approx(0.2, rel=1e-3)
    assert figures["r_err_median_deg"] == pytest.approx(np.rad2deg(0.02), rel=1e-3)
    assert figures["t_err_p95_m"] == pytest.approx(0.56, rel=1e-3)


def test_a_loop_is_wrong_beyond_either_limit() -> None:
    loops = tally(off_by(0.29, 0.0), off_by(0.31, 0.0), off_by(0.0, 0.04), off_by(0.0, 0.06))
    assert loops.wrong(Limits(0.3, 0.05)).tolist() == [False, True, False, True]


def test_without_loops_there_are_no_figures() -> None:
    nothing = Tally()
    nothing.add(TRUTH, Timed(NoPose("matches"), 2.0, {"matching": 2.0}))
    assert nothing.rejected == {"matches": 1}
    assert not nothing.wrong(Limits(1.0, 1.0)).any()
    assert set(error_figures(nothing).values()) == {None}
    assert nothing.nees() is None
    assert set(nees_figures(None).values()) == {None}
    assert time_figures([])["ms_median"] is None


def test_poses_without_covariance_have_no_nees() -> None:
    assert tally(off_by(0.1, 0.0)).nees() is None


def test_nees_figures_are_of_the_values() -> None:
    figures = nees_figures(np.array([2.0, 4.0, 30.0]))
    assert figures == {"nees_mean": 12.0, "nees_median": 4.0, "nees_over_22_5": 0.33333}


def test_stages_that_were_not_reached_count_as_nothing() -> None:
    assert stage_figures([{"a": 2.0, "b": 4.0}, {"a": 4.0}]) == {"a": 3.0, "b": 2.0}
    assert stage_figures([]) == {}


def test_a_time_is_shared_out_among_the_stages() -> None:
    def solve() -> NoPose:
        core.bearing_vectors("PINHOLE", [1.0, 1.0, 0.0, 0.0], np.zeros((200_000, 2)))
        return NoPose("matches", [("matching", 1.0), ("rig", 2.0), ("rig", 1.0)])

    attempt = timed(solve)
    assert attempt.ms > 0
    assert attempt.stage_ms["rig"] == pytest.approx(3 * attempt.stage_ms["matching"])
    assert attempt.without_matching_ms == pytest.approx(attempt.ms - attempt.stage_ms["matching"])


def test_five_digits_are_kept() -> None:
    assert rounded(np.float64(123.4567)) == 123.46
    assert rounded(0.000123456) == 0.00012346
