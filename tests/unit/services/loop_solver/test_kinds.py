"""Jobs by kind of feature: what both sides share is matched, and nothing shared is a rejection."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import covinz_core
import numpy as np
import pytest

from covinz import codec, frames
from covinz.config import FeatureKind, LoopSolverConfig, MatchingConfig
from covinz.types import Features, FeatureType, Keyframe, LoopClosure, Outcome, Rejection
from services.loop_solver.kinds import shared_kind
from services.loop_solver.solver import LoopSolver, fast_loop_options, loop_options

ORB, SIFT = FeatureType.ORB, FeatureType.SIFT
PROFILES = pytest.mark.parametrize("profile", ["fast", "paper"])


def as_sift(orb: Features) -> Features:
    """Numbers that are as alike as the bits are."""
    return Features(SIFT, orb.keypoints_px, np.tile(orb.descriptors // 2, (1, 4)))


def with_kinds(room: Any, kinds_of: Callable[[Keyframe], tuple[FeatureType, ...]]) -> Any:
    """The room with other features in its keyframes; a kind that comes second is noise."""
    for kf_id, kf in list(room.store.keyframes.items()):
        blocks: list[Features] = []
        for kind in kinds_of(kf):
            features = kf.features if kind is ORB else as_sift(kf.features)
            blocks.append(noisy(features) if blocks else features)
        room.store.keyframes[kf_id] = dataclasses.replace(
            kf, features=blocks[0], more_features=tuple(blocks[1:])
        )
    return room


def noisy(features: Features) -> Features:
    rng = np.random.default_rng(len(features))
    noise = rng.integers(0, 256, features.descriptors.shape, dtype=np.uint8)
    return dataclasses.replace(features, descriptors=noise)


def solve(room: Any, **options: Any) -> Outcome:
    return LoopSolver(LoopSolverConfig(**options), room.store).solve(room.job)


def assert_true_loop(outcome: Outcome, room: Any) -> None:
    assert isinstance(outcome, LoopClosure), outcome
    error = frames.local_error(room.T_cand_query, outcome.T_cand_query)
    assert np.linalg.norm(error[:3]) < 0.02
    assert np.linalg.norm(error[3:]) < 0.06


@PROFILES
def test_sift_closes_a_loop(room: Any, profile: str) -> None:
    with_kinds(room, lambda kf: (SIFT,))
    assert_true_loop(solve(room, profile=profile), room)


@PROFILES
def test_of_two_shared_kinds_the_preferred_one_is_used(room: Any, profile: str) -> None:
    """ORB comes first in every keyframe and is true; SIFT is noise."""
    with_kinds(room, lambda kf: (ORB, SIFT))
    assert_true_loop(solve(room, profile=profile, kinds=("orb", "sift")), room)
    outcome = solve(room, profile=profile)
    assert isinstance(outcome, Rejection)
    assert outcome.stage in ("matches", "rig_inliers")


@PROFILES
def test_a_kind_that_only_one_keyframe_lacks_is_not_used(room: Any, profile: str) -> None:
    lacks = room.job.cand_rig[2].keyframe
    with_kinds(room, lambda kf: (ORB,) if kf.id == lacks else (ORB, SIFT))
    assert_true_loop(solve(room, profile=profile), room)


@PROFILES
def test_sides_without_a_common_kind_are_rejected(room: Any, profile: str) -> None:
    with_kinds(room, lambda kf: (ORB,) if kf.id.agent == "a" else (SIFT,))
    outcome = solve(room, profile=profile)
    assert isinstance(outcome, Rejection)
    assert outcome.stage == "feature_kind"
    assert "the query's rig have orb, of the candidate's sift" in outcome.detail
    assert codec.decode_outcome(codec.encode(outcome)) == outcome


def test_a_neighbour_without_the_kind_is_rejected_too(room: Any) -> None:
    lacks = room.job.cand_rig[1].keyframe
    with_kinds(room, lambda kf: (SIFT,) if kf.id == lacks else (ORB,))
    outcome = solve(room)
    assert isinstance(outcome, Rejection)
    assert outcome.stage == "feature_kind"
    assert "of the candidate's no kind in common" in outcome.detail


def test_a_kind_that_is_not_in_use_does_not_count(room: Any) -> None:
    with_kinds(room, lambda kf: (SIFT,))
    outcome = solve(room, kinds=("orb",))
    assert isinstance(outcome, Rejection)
    assert outcome.stage == "feature_kind"
    assert outcome.detail.endswith("in use: orb")


@pytest.mark.parametrize(
    ("preferred", "kind"), [(("sift", "orb"), SIFT), (("orb", "sift"), ORB), (("orb",), ORB)]
)
def test_preference(room: Any, preferred: tuple[FeatureKind, ...], kind: FeatureType) -> None:
    with_kinds(room, lambda kf: (ORB, SIFT))
    assert shared_kind(room.job, room.store, preferred) is kind


@pytest.mark.parametrize("options_of", [loop_options, fast_loop_options])
def test_matching_options_are_those_of_the_kind(options_of: Any) -> None:
    matching = MatchingConfig(max_hamming=33, max_sift_distance=321.0, max_ratio=0.7)
    config = LoopSolverConfig(matching=matching)
    orb, sift = (options_of(config, 1, kind).matching for kind in (ORB, SIFT))
    assert (orb.norm, orb.max_distance) == (covinz_core.DescriptorNorm.HAMMING, 33)
    assert (sift.norm, sift.max_distance) == (covinz_core.DescriptorNorm.L2, 321)
    assert orb.max_ratio == sift.max_ratio == 0.7
