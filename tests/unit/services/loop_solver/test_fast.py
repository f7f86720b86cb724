"""Profile `fast` in the worker: truth, determinism, thresholds, and what the outcome carries."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from covinz import codec, frames
from covinz.config import FastLoopConfig, LoopSolverConfig, MatchingConfig
from covinz.types import LoopClosure, LoopJob, Outcome, Rejection
from services.loop_solver.solver import LoopSolver, fast_loop_options

CONFIG = LoopSolverConfig(profile="fast")


def solve(room: Any, config: LoopSolverConfig = CONFIG) -> Outcome:
    return LoopSolver(config, room.store).solve(room.job)


def solved(room: Any) -> LoopClosure:
    outcome = solve(room)
    assert isinstance(outcome, LoopClosure)
    return outcome


def with_cand_rig(room: Any, members: Any) -> Any:
    return dataclasses.replace(room, job=dataclasses.replace(room.job, cand_rig=tuple(members)))


def test_a_loop_has_the_true_pose_within_its_covariance(room: Any) -> None:
    outcome = solved(room)
    error = frames.local_error(room.T_cand_query, outcome.T_cand_query)
    assert np.linalg.norm(error[:3]) < 0.003
    assert np.linalg.norm(error[3:]) < 0.02
    # Chi-square, 6 degrees, 1 in 10^6.
    assert error @ np.linalg.solve(outcome.covariance, error) < 40
    # Decimetres of odometry cannot tell the scale to a millimetre.
    assert np.sqrt(np.trace(outcome.covariance[3:, 3:])) > 0.001
    assert 100 <= outcome.num_inliers <= outcome.num_matches


def test_same_job_same_bits_whatever_was_solved_before(room: Any, bare_room: Any) -> None:
    used = LoopSolver(CONFIG, room.store)
    used.solve(bare_room.job)
    used.solve(dataclasses.replace(room.job, id="f" * 32))
    one, two = (
        codec.encode(dataclasses.replace(solver.solve(room.job), solver_ms=0.0))
        for solver in (LoopSolver(CONFIG, room.store), used)
    )
    assert one == two


def test_the_whole_odometry_frame_may_move(room: Any) -> None:
    T = frames.transform(frames.so3_exp([0.4, -1.0, 0.3]), [10.0, -4.0, 2.0])
    members = [
        dataclasses.replace(member, T_odom_body=T @ member.T_odom_body)
        for member in room.job.cand_rig
    ]
    one, two = solved(room), solved(with_cand_rig(room, members))
    np.testing.assert_allclose(one.T_cand_query, two.T_cand_query, atol=1e-5)


def test_wrong_odometry_inside_a_rig_shows_in_its_residual(room: Any) -> None:
    """20 cm instead of the truth, in one motion of the candidate's rig, however sent."""
    base = solved(room)
    ends = [(m.from_keyframe.seq, m.to_keyframe.seq) for m in base.motion_residuals]
    assert ends == [(0, 1), (1, 2), (0, 1)]
    assert [m.to_keyframe.agent for m in base.motion_residuals] == ["b", "b", "a"]
    assert max(np.abs(m.residual).max() for m in base.motion_residuals) < 4
    first, second, third = room.job.cand_rig
    T = third.T_odom_body.copy()
    T[:3, 3] += 0.2
    outcome = solved(
        with_cand_rig(room, (first, second, dataclasses.replace(third, T_odom_body=T)))
    )
    sizes = [float(np.linalg.norm(m.residual)) for m in outcome.motion_residuals]
    assert int(np.argmax(sizes)) == 1
    assert sizes[1] > 5 + max(sizes[0], sizes[2])
    error = frames.local_error(room.T_cand_query, outcome.T_cand_query)
    assert np.linalg.norm(error[3:]) < 0.05


def test_two_equal_poses_are_ambiguous_and_both_are_told(torn_room: Any) -> None:
    outcome = solve(torn_room)
    assert isinstance(outcome, Rejection) and outcome.stage == "ambiguous"
    assert outcome.count < outcome.threshold
    assert "two solutions" in outcome.detail
    assert len(outcome.solutions) == 2
    # One of them keeps the points that stayed, the other one those that moved.
    moved_m = sorted(
        float(np.linalg.norm(frames.local_error(torn_room.T_cand_query, found.T_cand_query)[3:]))
        for found in outcome.solutions
    )
    assert moved_m[0] < 0.05 and moved_m[1] == pytest.approx(1.0, abs=0.1)
    for found in outcome.solutions:
        assert np.linalg.eigvalsh(found.covariance)[0] > 0
        assert found.num_inliers > 100


def test_every_threshold_reaches_the_core(room: Any, bare_room: Any) -> None:
    strict = {
        "matches": LoopSolverConfig(profile="fast", min_rig_inliers=50_000),
        "uncertainty": LoopSolverConfig(
            profile="fast", fast=FastLoopConfig(max_sigma_translation_m=1e-6)
        ),
        "degenerate": LoopSolverConfig(profile="fast", min_baseline_m=50.0),
        "translation": LoopSolverConfig(profile="fast", max_translation_m=0.01),
        "rotation": LoopSolverConfig(profile="fast", max_rotation_rad=0.001),
    }
    for stage, config in strict.items():
        outcome = solve(room, config)
        assert isinstance(outcome, Rejection)
        assert outcome.stage == stage and not outcome.solutions
    # 25 points in six pairs.
    bare = solve(bare_room, LoopSolverConfig(profile="fast", min_rig_inliers=200))
    assert isinstance(bare, Rejection) and bare.stage in ("matches", "rig_inliers")
    assert bare.count < bare.threshold == 200


def test_every_option_is_passed_on() -> None:
    config = LoopSolverConfig(
        profile="fast",
        matching=MatchingConfig(max_ratio=0.71, max_hamming=33, mutual=False),
        min_rig_inliers=77,
        fast=FastLoopConfig(
            max_error_px=1.5,
            confidence=0.95,
            max_iterations=111,
            max_refined=3,
            min_significance=2.5,
            max_sigma_translation_m=0.2,
        ),
    )
    options = fast_loop_options(config, seed=2**64 - 1)
    options.check()
    assert options.seed == 2**64 - 1
    assert (options.matching.max_ratio, options.matching.max_distance) == (0.71, 33)
    assert options.matching.mutual is False
    hypotheses = options.hypotheses
    assert (hypotheses.max_error_px, hypotheses.confidence) == (1.5, 0.95)
    assert (hypotheses.max_num_iterations, options.max_num_refined) == (111, 3)
    assert (options.min_num_inliers, options.selection.min_significance) == (77, 2.5)
    assert options.max_sigma_translation_m == 0.2


def test_a_sent_covariance_is_used(room: Any) -> None:
    """An odometry that says that it is bad makes the loop less sure."""
    assert isinstance(room.job, LoopJob)
    before = solved(room)
    bad = [
        dataclasses.replace(member, motion_covariance=0.01 * np.eye(6))
        for member in room.job.cand_rig
    ]
    after = solved(with_cand_rig(room, bad))
    assert np.trace(after.covariance[3:, 3:]) > 2 * np.trace(before.covariance[3:, 3:])
