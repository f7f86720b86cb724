from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from covinz import codec, frames
from covinz.config import LoopSolverConfig, MatchingConfig
from covinz.keyframes import StoreUnavailable
from covinz.types import Camera, FeatureType, LoopClosure, Outcome, Rejection
from services.loop_solver.rig import BadRig, build_rig
from services.loop_solver.solver import LoopSolver, loop_options

CONFIG = LoopSolverConfig(profile="paper")


def solve(room: Any, config: LoopSolverConfig = CONFIG) -> Outcome:
    return LoopSolver(config, room.store).solve(room.job)


def bits(outcome: Outcome) -> bytes:
    return codec.encode(dataclasses.replace(outcome, solver_ms=0.0))


def test_a_loop_has_the_true_pose(room: Any) -> None:
    outcome = solve(room)
    assert isinstance(outcome, LoopClosure)
    error = frames.local_error(room.T_cand_query, outcome.T_cand_query)
    assert np.linalg.norm(error[:3]) < 0.02
    assert np.linalg.norm(error[3:]) < 0.06
    assert outcome.job_id == room.job.id
    assert (outcome.query, outcome.cand) == (room.job.query, room.job.cand)
    assert 100 <= outcome.num_inliers <= outcome.num_matches
    np.testing.assert_array_equal(outcome.covariance, outcome.covariance.T)
    assert np.linalg.eigvalsh(outcome.covariance).min() > 0
    # The error is one that the covariance allows for (chi-square, 6 degrees, 1 in 10^6).
    assert error @ np.linalg.solve(outcome.covariance, error) < 40


def test_same_job_same_bits_whatever_was_solved_before(room: Any, bare_room: Any) -> None:
    first = LoopSolver(CONFIG, room.store)
    second = LoopSolver(CONFIG, room.store)
    LoopSolver(CONFIG, bare_room.store).solve(bare_room.job)
    second.solve(dataclasses.replace(room.job, id="f" * 32))
    assert (
        bits(first.solve(room.job)) == bits(second.solve(room.job)) == bits(first.solve(room.job))
    )


def test_the_seed_is_the_job_s(room: Any) -> None:
    other = dataclasses.replace(room, job=dataclasses.replace(room.job, id="f" * 32))
    one, two = solve(room), solve(other)
    assert isinstance(one, LoopClosure) and isinstance(two, LoopClosure)
    assert not np.array_equal(one.covariance, two.covariance)


def test_the_rig_is_in_the_frame_of_its_first_member(room: Any) -> None:
    """Moving a whole odometry frame changes nothing but rounding."""
    T = frames.transform(frames.so3_exp([0.4, -1.0, 0.3]), [10.0, -4.0, 2.0])
    moved = dataclasses.replace(
        room.job,
        cand_rig=tuple(
            dataclasses.replace(m, T_odom_body=T @ m.T_odom_body) for m in room.job.cand_rig
        ),
    )
    one, two = solve(room), solve(dataclasses.replace(room, job=moved))
    assert isinstance(one, LoopClosure) and isinstance(two, LoopClosure)
    np.testing.assert_allclose(one.T_cand_query, two.T_cand_query, atol=1e-3)


def test_a_bare_room_is_a_rejection_with_stage_count_and_threshold(bare_room: Any) -> None:
    outcome = solve(bare_room)
    assert isinstance(outcome, Rejection)
    assert outcome.stage in ("matches", "pair_inliers")
    assert outcome.count < outcome.threshold == 30
    # Which pair: a query camera with a candidate camera.
    query, cand = outcome.detail.split(" with ")
    assert query in {str(m.keyframe) for m in bare_room.job.query_rig}
    assert cand in {str(m.keyframe) for m in bare_room.job.cand_rig}


def test_the_detail_names_the_pair_that_failed(room: Any) -> None:
    blind = room.job.cand_rig[1].keyframe
    kf = room.store.keyframes[blind]
    noise = np.random.default_rng(1).integers(0, 256, kf.features.descriptors.shape, dtype=np.uint8)
    features = dataclasses.replace(kf.features, descriptors=noise)
    room.store.keyframes[blind] = dataclasses.replace(kf, features=features)
    outcome = solve(room)
    assert isinstance(outcome, Rejection) and outcome.stage == "matches"
    assert outcome.detail == f"{room.job.query} with {blind}"


def test_every_threshold_reaches_the_core(room: Any) -> None:
    strict = {
        "matches": LoopSolverConfig(profile="paper", min_pair_matches=5000),
        "pair_inliers": LoopSolverConfig(profile="paper", min_pair_inliers=5000),
        "rig_inliers": LoopSolverConfig(profile="paper", min_rig_inliers=5000),
        "covariance": LoopSolverConfig(profile="paper", max_covariance_error_px=1e-6),
        "uncertainty": LoopSolverConfig(profile="paper", max_covariance_trace=1e-12),
        "scale": LoopSolverConfig(profile="paper", max_common_centre_ratio=0.001),
        "degenerate": LoopSolverConfig(profile="paper", min_baseline_m=50.0),
        "translation": LoopSolverConfig(profile="paper", max_translation_m=0.01),
        "rotation": LoopSolverConfig(profile="paper", max_rotation_rad=0.001),
    }
    for stage, config in strict.items():
        outcome = solve(room, config)
        assert isinstance(outcome, Rejection)
        assert outcome.stage == stage


def test_every_option_is_passed_on() -> None:
    config = LoopSolverConfig(
        profile="paper",
        matching=MatchingConfig(max_ratio=0.71, max_hamming=33, mutual=False),
        max_error_px=1.5,
        confidence=0.95,
        max_pair_iterations=111,
        max_rig_iterations=222,
        num_covariance_samples=33,
        max_covariance_tries=44,
        min_covariance_inlier_ratio=0.55,
        max_covariance_error_px=6.6,
    )
    options = loop_options(config, seed=2**64 - 1)
    options.check()
    assert options.seed == 2**64 - 1
    assert (options.matching.max_ratio, options.matching.max_distance) == (0.71, 33)
    assert options.matching.mutual is False
    assert options.pair.max_error_px == options.rig.max_error_px == 1.5
    assert options.pair.confidence == options.rig.confidence == 0.95
    assert (options.pair.max_num_iterations, options.rig.max_num_iterations) == (111, 222)
    covariance = options.covariance
    assert (covariance.num_samples, covariance.max_num_tries) == (33, 44)
    assert (covariance.min_inlier_ratio, covariance.max_error_px) == (0.55, 6.6)


def test_missing_keyframe_and_camera_are_final(room: Any) -> None:
    gone = room.job.cand_rig[2].keyframe
    kf = room.store.keyframes.pop(gone)
    outcome = solve(room)
    assert isinstance(outcome, Rejection)
    assert outcome.stage == "keyframe_missing" and str(gone) in outcome.detail
    room.store.keyframes[gone] = kf
    room.store.cameras.clear()
    outcome = solve(room)
    assert isinstance(outcome, Rejection) and outcome.stage == "camera_missing"


def test_an_unreachable_store_decides_nothing(room: Any) -> None:
    room.store.times_away = 1
    with pytest.raises(StoreUnavailable):
        solve(room)
    assert isinstance(solve(room), LoopClosure)


def bad_cameras(camera: Camera) -> Iterator[Camera]:
    yield dataclasses.replace(camera, model="EQUIRECTANGULAR", params=camera.params)
    yield dataclasses.replace(camera, params=camera.params[:3])
    yield dataclasses.replace(camera, T_body_cam=2 * np.eye(4))


def test_bad_input_is_a_rejection_with_the_reason(room: Any) -> None:
    ((camera_hash, camera),) = room.store.cameras.items()
    for bad in bad_cameras(camera):
        room.store.cameras[camera_hash] = bad
        outcome = solve(room)
        assert isinstance(outcome, Rejection)
        assert outcome.stage == "error" and outcome.detail
        codec.encode(outcome)


def test_a_keyframe_without_features_is_a_bad_rig(room: Any) -> None:
    first = room.job.query
    kf = room.store.keyframes[first]
    room.store.keyframes[first] = dataclasses.replace(kf, features=None)
    with pytest.raises(BadRig, match="no ORB features"):
        build_rig(room.job.query_rig, room.store, FeatureType.ORB)
    outcome = solve(room)
    assert isinstance(outcome, Rejection) and outcome.stage == "features_expired"
    assert str(first) in outcome.detail


def test_time_is_that_of_the_core(room: Any) -> None:
    ticks = iter([10.0, 10.25])
    outcome = LoopSolver(CONFIG, room.store, clock_s=lambda: next(ticks)).solve(room.job)
    assert outcome.solver_ms == 250.0
