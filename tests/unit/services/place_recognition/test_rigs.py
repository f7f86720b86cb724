from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from covinz.config import LoopSolverConfig, MatchingConfig
from covinz.types import Keyframe, KeyframeId, SegmentId
from services.place_recognition.rigs import JobMint, Pair, Rig, cand_rig, overlap, query_rig
from services.place_recognition.track import Track

SEGMENT = SegmentId("a", "01ARZ3NDEKTSV4RRFFQ69G5FAV")
OTHER = SegmentId("b", "01ARZ3NDEKTSV4RRFFQ69G5FAW")


def track_of(seqs: list[int], segment: SegmentId = SEGMENT) -> Track:
    track = Track(segment)
    for seq in seqs:
        kf_id = KeyframeId(segment.agent, segment.session, seq)
        track.insert(Keyframe(kf_id, seq, np.eye(4), "0123456789abcdef", None))
    return track


def seqs(rig: Rig | None) -> list[int] | None:
    return None if rig is None else [m.keyframe.seq for m in rig]


def test_query_rig_is_the_keyframe_and_its_predecessor() -> None:
    assert seqs(query_rig(track_of([0, 1, 2]), 2)) == [2, 1]


def test_a_session_s_first_query_uses_its_successor_and_waits_for_it() -> None:
    assert query_rig(track_of([0]), 0) is None
    assert seqs(query_rig(track_of([0, 3]), 0)) == [0, 3]


def test_cand_rig_has_predecessor_and_successor() -> None:
    assert seqs(cand_rig(track_of([0, 1, 2, 3]), 1)) == [1, 0, 2]


def test_cand_rig_at_the_end_has_two_predecessors() -> None:
    assert seqs(cand_rig(track_of([0, 1, 2]), 2)) == [2, 1, 0]


def test_cand_rig_at_the_beginning_has_two_successors() -> None:
    assert seqs(cand_rig(track_of([0, 1, 2]), 0)) == [0, 1, 2]


def test_cand_rig_waits_for_three_keyframes() -> None:
    assert cand_rig(track_of([0]), 0) is None
    assert cand_rig(track_of([0, 1]), 0) is None
    assert cand_rig(track_of([0, 1]), 1) is None


@given(st.lists(st.integers(0, 40), min_size=1, max_size=12, unique=True), st.data())
def test_neighbours_are_the_nearest_logged_whatever_the_order(
    arrival: list[int], data: st.DataObject
) -> None:
    seq = data.draw(st.sampled_from(arrival))
    track = track_of(arrival)
    before = sorted((s for s in arrival if s < seq), reverse=True)
    after = sorted(s for s in arrival if s > seq)
    assert seqs(query_rig(track, seq)) == (
        [seq, *(before or after)[:1]] if len(arrival) > 1 else None
    )
    two = [before[0], after[0]] if before and after else (before + after)[:2]
    assert seqs(cand_rig(track, seq)) == ([seq, *two] if len(two) == 2 else None)


def test_rigs_overlap_when_they_share_a_keyframe() -> None:
    track, other = track_of([0, 1, 2, 3, 4]), track_of([0, 1, 2], OTHER)
    query = query_rig(track, 4)
    assert query is not None
    for seq, shared in ((0, False), (1, False), (2, True), (3, True)):
        cand = cand_rig(track, seq)
        assert cand is not None
        assert overlap(query, cand) is shared
    apart = cand_rig(other, 1)
    assert apart is not None
    assert not overlap(query, apart)


def job_id(
    solver: LoopSolverConfig | None = None, vocabulary: str = "v", score: float = 1.0
) -> str:
    track, other = track_of([0, 1, 2]), track_of([0, 1, 2], OTHER)
    query, cand = query_rig(track, 2), cand_rig(other, 1)
    assert query is not None and cand is not None
    pair = Pair(query[0].keyframe, cand[0].keyframe, score)
    job = JobMint(solver or LoopSolverConfig(), vocabulary).job(pair, query, cand)
    assert job.query == pair.query and job.cand == pair.cand and job.score == score
    return job.id


def test_job_id_says_what_was_asked() -> None:
    assert len(job_id()) == 32 and int(job_id(), 16) >= 0
    assert job_id() == job_id(score=2.0)
    others = {
        job_id(vocabulary="w"),
        job_id(LoopSolverConfig(min_rig_inliers=99)),
        job_id(LoopSolverConfig(matching=MatchingConfig(mutual=False))),
    }
    assert len(others | {job_id()}) == 4
