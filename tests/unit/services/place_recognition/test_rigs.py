from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from covinz.config import LoopSolverConfig, MatchingConfig, OdometryNoise, RigConfig
from covinz.frames import transform
from covinz.types import Array, Camera, Keyframe, KeyframeId, SegmentId
from services.place_recognition.rigs import JobMint, Pair, Rig, RigRule, nearest, overlap
from services.place_recognition.track import Track

SEGMENT = SegmentId("a", "01ARZ3NDEKTSV4RRFFQ69G5FAV")
OTHER = SegmentId("b", "01ARZ3NDEKTSV4RRFFQ69G5FAW")
HASH = "0123456789abcdef"
# What every covariance has at least: core/include/covinz/odometry.h.
FLOOR = np.diag(np.repeat([1e-4**2, 1e-3**2], 3))
# Looks sideways: bodies move along x.
CAMERA = Camera("PINHOLE", 640, 480, np.array([500.0, 500.0, 319.5, 239.5]), np.eye(4))


def track_of(
    seqs: list[int],
    segment: SegmentId = SEGMENT,
    step_m: float = 0.08,
    covariance: Array | None = None,
) -> Track:
    track = Track(segment, OdometryNoise())
    for seq in seqs:
        add(track, seq, step_m, covariance)
    return track


def add(track: Track, seq: int, step_m: float = 0.08, covariance: Array | None = None) -> None:
    kf_id = KeyframeId(track.segment.agent, track.segment.session, seq)
    T_odom_body = transform(np.eye(3), [step_m * seq, 0.0, 0.0])
    kf = Keyframe(kf_id, 10_000_000 * seq, T_odom_body, HASH, None, covariance)
    track.path.insert(seq, kf.stamp_ns, T_odom_body, covariance)
    track.insert(kf)


def seqs(rig: Rig | None) -> list[int] | None:
    return None if rig is None else [m.keyframe.seq for m in rig.members]


PAPER = LoopSolverConfig(profile="paper")


def rule(solver: LoopSolverConfig = PAPER, **rigs: Any) -> RigRule:
    return RigRule(RigConfig(**rigs), solver, {HASH: CAMERA}.get)


def pair_of(query: int, cand: int, segment: SegmentId = OTHER) -> Pair:
    return Pair(
        KeyframeId(SEGMENT.agent, SEGMENT.session, query),
        KeyframeId(segment.agent, segment.session, cand),
        1.0,
    )


def query_seqs(track: Track, seq: int, rule: RigRule) -> list[int] | None:
    return seqs(rule.query(pair_of(seq, 0), track))


def cand_seqs(track: Track, seq: int, rule: RigRule) -> list[int] | None:
    pair = pair_of(seq, 0)
    return seqs(rule.cand(Pair(pair.cand, pair.query, 1.0), track))


def test_the_paper_s_query_rig_is_the_keyframe_and_its_predecessor() -> None:
    assert query_seqs(track_of([0, 1, 2]), 2, rule()) == [2, 1]


def test_a_session_s_first_query_uses_its_successor_and_waits_for_it() -> None:
    for solver in (PAPER, LoopSolverConfig()):
        assert query_seqs(track_of([0]), 0, rule(solver)) is None
        assert query_seqs(track_of([0, 3]), 0, rule(solver)) == [0, 3]


def test_the_paper_s_cand_rig_has_predecessor_and_successor() -> None:
    assert cand_seqs(track_of([0, 1, 2, 3]), 1, rule()) == [1, 0, 2]


def test_cand_rig_at_the_end_has_two_predecessors() -> None:
    assert cand_seqs(track_of([0, 1, 2]), 2, rule()) == [2, 1, 0]


def test_cand_rig_at_the_beginning_has_two_successors() -> None:
    assert cand_seqs(track_of([0, 1, 2]), 0, rule()) == [0, 1, 2]


def test_cand_rig_waits_for_three_keyframes() -> None:
    for solver in (PAPER, LoopSolverConfig()):
        for size in (3, 5):
            form = rule(solver, cand_size=size)
            assert cand_seqs(track_of([0]), 0, form) is None
            assert cand_seqs(track_of([0, 1]), 0, form) is None
            assert cand_seqs(track_of([0, 1]), 1, form) is None
            found = cand_seqs(track_of([0, 1, 2]), 1, form)
            assert found is not None and sorted(found) == [0, 1, 2]


def test_larger_rigs_by_index_take_both_sides_by_turns() -> None:
    form = rule(query_size=4, cand_size=5)
    assert query_seqs(track_of([0, 1, 2, 3, 4, 5]), 5, form) == [5, 4, 3, 2]
    assert cand_seqs(track_of([0, 1, 2, 3, 4, 5]), 2, form) == [2, 1, 0, 3, 4]
    assert cand_seqs(track_of([0, 1, 2, 3, 4, 5]), 5, form) == [5, 4, 3, 2, 1]


@given(st.lists(st.integers(0, 40), min_size=1, max_size=12, unique=True), st.data())
def test_the_paper_s_neighbours_are_the_nearest_logged_whatever_the_order(
    arrival: list[int], data: st.DataObject
) -> None:
    seq = data.draw(st.sampled_from(arrival))
    track = track_of(arrival)
    before = sorted((s for s in arrival if s < seq), reverse=True)
    after = sorted(s for s in arrival if s > seq)
    assert query_seqs(track, seq, rule()) == (
        [seq, *(before or after)[:1]] if len(arrival) > 1 else None
    )
    two = [before[0], after[0]] if before and after else (before + after)[:2]
    assert cand_seqs(track, seq, rule()) == ([seq, *two] if len(two) == 2 else None)


@given(st.permutations(range(12)), st.integers(0, 11))
def test_the_order_of_arrival_does_not_matter(arrival: list[int], seq: int) -> None:
    form = rule(LoopSolverConfig(), query_size=3, cand_size=4)
    ordered, mixed = track_of(sorted(arrival)), track_of(arrival)
    one, other = form.query(pair_of(seq, 0), ordered), form.query(pair_of(seq, 0), mixed)
    assert one is not None and other is not None
    assert seqs(one) == seqs(other) and one.information == other.information
    for a, b in zip(one.members, other.members, strict=True):
        np.testing.assert_array_equal(a.motion_covariance, b.motion_covariance)


@settings(max_examples=15, deadline=None)
@given(st.permutations(range(9)), st.booleans())
def test_rigs_are_those_of_a_rule_that_never_saw_another(
    arrival: list[int], is_same_session: bool
) -> None:
    segment = SEGMENT if is_same_session else OTHER
    solver, options = LoopSolverConfig(), {"query_size": 3, "cand_size": 4}
    used, track = rule(solver, **options), track_of([])
    for count, seq in enumerate(arrival, start=1):
        add(track, seq)
        known = sorted(arrival[:count])
        same_track = track_of(known)
        for pair in (pair_of(one, other, segment) for one in known for other in (known[0], 8)):
            if pair.query != pair.cand:
                for fresh_track in (same_track, track):
                    fresh = rule(solver, **options).query(pair, fresh_track)
                    same_rig(used.query(pair, track), fresh)


def same_rig(one: Rig | None, other: Rig | None) -> None:
    assert seqs(one) == seqs(other)
    if one is not None and other is not None:
        assert one.information == other.information
        for a, b in zip(one.members, other.members, strict=True):
            np.testing.assert_array_equal(a.motion_covariance, b.motion_covariance)
            np.testing.assert_array_equal(a.twists, b.twists)


def test_the_profile_decides_unless_the_configuration_does() -> None:
    # A step is 8 cm: the next keyframe tells less about scale than those after it.
    track = track_of(list(range(20)))
    by_index, by_geometry = [10, 9, 11], cand_seqs(track, 10, rule(LoopSolverConfig()))
    assert by_geometry is not None and min(by_geometry) < 8 and max(by_geometry) > 12
    assert cand_seqs(track, 10, rule(PAPER)) == by_index
    assert cand_seqs(track, 10, rule(LoopSolverConfig(), neighbours="index")) == by_index
    assert cand_seqs(track, 10, rule(PAPER, neighbours="geometry")) == by_geometry


def test_without_a_usable_calibration_the_nearest_are_taken() -> None:
    track = track_of(list(range(20)))
    broken = dataclasses.replace(CAMERA, params=CAMERA.params[:3])
    for cameras in ({}, {HASH: broken}):
        form = RigRule(RigConfig(), LoopSolverConfig(), cameras.get)
        assert cand_seqs(track, 10, form) == [10, 9, 11]


def test_rigs_of_one_session_never_meet() -> None:
    # Standing still for long, and rigs of five that would like to reach far.
    track = track_of([*range(5), *range(30, 35)], step_m=0.0)
    form = rule(LoopSolverConfig(), query_size=5, cand_size=5)
    for query, cand in ((30, 4), (34, 0), (4, 30)):
        pair = pair_of(query, cand, SEGMENT)
        one, other = form.query(pair, track), form.cand(pair, track)
        assert one is not None and other is not None
        assert not overlap(one.members, other.members)
        assert all(abs(s - query) < abs(s - cand) for s in seqs(one) or [])


def test_members_carry_what_odometry_knows_of_the_motions_between_them() -> None:
    sent = np.diag(np.arange(1.0, 7.0)) * 1e-5
    track = track_of(list(range(20)), covariance=sent)
    rig = rule(LoopSolverConfig()).cand(Pair(pair_of(0, 0).cand, pair_of(10, 0).query, 1.0), track)
    assert rig is not None
    first, *later = sorted(rig.members, key=lambda member: member.keyframe.seq)
    assert first.motion_covariance is None
    for before, member in pairwise([first, *later]):
        num_steps = member.keyframe.seq - before.keyframe.seq
        assert num_steps > 1 and member.motion_covariance is not None
        # Straight on and without turns: rotations and lengths along the way just add up.
        found = np.diag(member.motion_covariance - FLOOR)
        np.testing.assert_allclose(found[:4], num_steps * np.diag(sent)[:4], rtol=1e-9)


def test_rigs_overlap_when_they_share_a_keyframe() -> None:
    track, other = track_of([0, 1, 2, 3, 4]), track_of([0, 1, 2], OTHER)
    query = nearest(track, 4, 2)
    assert query is not None
    for seq, shared in ((0, False), (1, False), (2, True), (3, True)):
        cand = nearest(track, seq, 3)
        assert cand is not None
        assert overlap(query.members, cand.members) is shared
    apart = nearest(other, 1, 3)
    assert apart is not None
    assert not overlap(query.members, apart.members)


def job_id(
    solver: LoopSolverConfig | None = None,
    vocabulary: str = "v",
    score: float = 1.0,
    rigs: RigConfig | None = None,
) -> str:
    track, other = track_of([0, 1, 2]), track_of([0, 1, 2], OTHER)
    query, cand = nearest(track, 2, 2), nearest(other, 1, 3)
    assert query is not None and cand is not None
    pair = pair_of(2, 1)
    mint = JobMint(solver or LoopSolverConfig(), rigs or RigConfig(), vocabulary)
    job = mint.job(pair, query.members, cand.members)
    assert job.query == pair.query and job.cand == pair.cand and job.score == score
    return job.id


def test_job_id_says_what_was_asked() -> None:
    assert len(job_id()) == 32 and int(job_id(), 16) >= 0
    others = {
        job_id(vocabulary="w"),
        job_id(LoopSolverConfig(min_rig_inliers=99)),
        job_id(LoopSolverConfig(matching=MatchingConfig(mutual=False))),
        job_id(rigs=RigConfig(neighbours="index")),
        job_id(rigs=RigConfig(depth_m=3.0)),
        job_id(rigs=RigConfig(cand_size=4)),
    }
    assert len(others | {job_id()}) == 7
