from __future__ import annotations

import numpy as np
import pytest

from covinz.config import OdometryNoise, PlaceRecognitionConfig
from covinz.frames import transform
from covinz.types import Keyframe, KeyframeId, SegmentId
from services.place_recognition.guards import (
    consistent,
    eligible,
    may_be_candidate,
    may_query,
)
from services.place_recognition.track import PastQuery, QueryHistory, Track

OWN = SegmentId("a", "01ARZ3NDEKTSV4RRFFQ69G5FAV")
EARLIER = SegmentId("a", "01ARZ3NDEKTSV4RRFFQ69G5FAU")


def config(**values: object) -> PlaceRecognitionConfig:
    return PlaceRecognitionConfig.model_validate(
        {"min_loop_keyframes": 0, "min_loop_s": 0.0, **values}
    )


def track_of(segment: SegmentId, count: int, first_slot: int = 0) -> Track:
    """Keyframes 2 s and 3 m apart; keyframe i is in slot first_slot + i."""
    track = Track(segment, OdometryNoise())
    for seq in range(count):
        kf_id = KeyframeId(segment.agent, segment.session, seq)
        T = transform(np.eye(3), [3.0 * seq, 0.0, 0.0])
        track.insert(Keyframe(kf_id, seq * 2_000_000_000, T, "0123456789abcdef", None))
        track.set_slot(seq, first_slot + seq)
    return track


def query(seq: int) -> KeyframeId:
    return KeyframeId(OWN.agent, OWN.session, seq)


@pytest.mark.parametrize(
    ("guard", "blocked"),
    [
        ({"min_loop_keyframes": 3}, [3, 4, 5]),
        ({"min_loop_s": 4.0}, [4, 5]),
        ({"min_loop_s": 4.1}, [3, 4, 5]),
        ({"min_loop_m": 9.0}, [3, 4, 5]),
        ({"min_loop_keyframes": 1, "min_loop_s": 2.1, "min_loop_m": 9.1}, [2, 3, 4, 5]),
        ({}, []),
    ],
)
def test_candidates_of_the_own_session_are_far_along_it(
    guard: dict[str, float], blocked: list[int]
) -> None:
    mask = eligible(query(5), 6, [track_of(OWN, 6)], config(**guard))
    assert np.flatnonzero(~mask).tolist() == blocked


def test_distance_counts_in_both_directions() -> None:
    mask = eligible(query(2), 6, [track_of(OWN, 6)], config(min_loop_keyframes=2))
    assert np.flatnonzero(~mask).tolist() == [1, 2, 3]


def test_an_earlier_session_of_the_agent_is_another_place_in_time() -> None:
    tracks = [track_of(EARLIER, 3), track_of(OWN, 3, first_slot=3)]
    mask = eligible(query(2), 8, tracks, config(min_loop_keyframes=100))
    assert mask.tolist() == [True] * 3 + [False] * 3 + [True] * 2


def test_other_agents_only_bars_every_session_of_the_agent() -> None:
    tracks = [track_of(EARLIER, 3), track_of(OWN, 3, first_slot=3)]
    mask = eligible(query(2), 8, tracks, config(other_agents_only=True))
    assert mask.tolist() == [False] * 6 + [True] * 2


def test_keyframes_outside_the_index_bar_nobody() -> None:
    track = track_of(OWN, 3)
    track.set_slot(0, -1)
    assert eligible(query(2), 4, [track], config(other_agents_only=True)).tolist() == [
        True,
        False,
        False,
        True,
    ]


def test_first_keyframes_may_be_kept_out() -> None:
    guards = config(start_after_keyframes=2, exclude_first_keyframes=3)
    track = track_of(OWN, 5)
    assert [may_query(seq, track, QueryHistory(), guards) for seq in range(4)] == [
        False,
        False,
        True,
        True,
    ]
    assert [may_be_candidate(seq, guards) for seq in range(5)] == [False] * 3 + [True] * 2


@pytest.mark.parametrize(
    ("guard", "rests"),
    [
        ({"query_spacing_keyframes": 2}, [5, 6]),
        ({"query_spacing_s": 5.0}, [5, 6]),
        ({"query_spacing_m": 3.1}, [5]),
        ({}, []),
    ],
)
def test_a_session_rests_after_a_query_that_gave_candidates(
    guard: dict[str, float], rests: list[int]
) -> None:
    history = QueryHistory()
    history.add(PastQuery(1, ()), productive=False)
    history.add(PastQuery(4, (query(0),)), productive=True)
    track = track_of(OWN, 9)
    after = [seq for seq in range(5, 9) if not may_query(seq, track, history, config(**guard))]
    assert after == rests


def test_consistency_wants_neighbours_among_earlier_candidates() -> None:
    guards = config(consistent_queries=2)
    cand = KeyframeId("b", EARLIER.session, 10)

    def near(seq: int) -> KeyframeId:
        return KeyframeId("b", EARLIER.session, seq)

    def history(*candidates: tuple[KeyframeId, ...]) -> QueryHistory:
        past = QueryHistory()
        for seq, found in enumerate(candidates):
            past.add(PastQuery(seq, found), productive=True)
        return past

    assert consistent(cand, 2, history((near(8),), (near(11), near(50))), guards)
    assert not consistent(cand, 2, history((near(7),), (near(11),)), guards)
    assert not consistent(cand, 2, history((near(9),), ()), guards)
    assert not consistent(cand, 1, history((near(9),)), guards)
    # Only the two before the query count, and only the candidate's own session.
    assert consistent(cand, 3, history((), (near(9),), (near(9),)), guards)
    elsewhere = KeyframeId("b", OWN.session, 10)
    assert not consistent(cand, 2, history((elsewhere,), (elsewhere,)), guards)
