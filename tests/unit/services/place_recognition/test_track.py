from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz.config import OdometryNoise
from covinz.frames import transform
from covinz.types import Keyframe, KeyframeId, SegmentId
from services.place_recognition.track import PastQuery, QueryHistory, Track

SEGMENT = SegmentId("a", "01ARZ3NDEKTSV4RRFFQ69G5FAV")


def keyframe(seq: int) -> Keyframe:
    # A path that bends, so that the order of summation matters.
    position = [np.cos(seq), np.sin(2 * seq), 0.1 * seq]
    return Keyframe(
        id=KeyframeId(SEGMENT.agent, SEGMENT.session, seq),
        stamp_ns=1_700_000_000_000_000_000 + seq * 500_000_000,
        T_odom_body=transform(np.eye(3), position),
        camera_hash="0123456789abcdef",
        features=None,
    )


def track_of(seqs: list[int]) -> Track:
    track = Track(SEGMENT, OdometryNoise())
    for seq in seqs:
        track.insert(keyframe(seq))
    return track


@given(st.permutations(range(0, 24, 2)))
def test_order_of_arrival_leaves_no_trace(seqs: list[int]) -> None:
    ordered, mixed = track_of(sorted(seqs)), track_of(seqs)
    for seq in seqs:
        for side in ("before", "after"):
            have_ids = [m.keyframe for m in getattr(mixed, side)(seq, 3)]
            assert have_ids == [m.keyframe for m in getattr(ordered, side)(seq, 3)]
        want, have = ordered.distances(seq), mixed.distances(seq)
        np.testing.assert_array_equal(have.keyframes, want.keyframes)
        np.testing.assert_array_equal(have.seconds, want.seconds)
        np.testing.assert_array_equal(have.metres, want.metres)


def test_neighbours_are_nearest_first_and_skip_gaps() -> None:
    track = track_of([0, 1, 5, 9])
    assert [m.keyframe.seq for m in track.before(9, 2)] == [5, 1]
    assert [m.keyframe.seq for m in track.after(0, 2)] == [1, 5]
    assert track.before(0, 2) == ()
    assert track.after(9, 2) == ()


def test_distances_have_units() -> None:
    track = Track(SEGMENT, OdometryNoise())
    for seq, x_m in ((0, 0.0), (1, 3.0), (2, 1.0)):
        kf = keyframe(seq)
        T = transform(np.eye(3), [x_m, 0.0, 0.0])
        track.insert(Keyframe(kf.id, kf.stamp_ns, T, kf.camera_hash, None))
    far = track.distances(2)
    assert far.keyframes.tolist() == [2, 1, 0]
    assert far.seconds.tolist() == [1.0, 0.5, 0.0]
    # Back and forth: along the path, not as the crow flies.
    assert far.metres.tolist() == [5.0, 2.0, 0.0]


def test_a_late_keyframe_lengthens_the_path_behind_it() -> None:
    track = Track(SEGMENT, OdometryNoise())
    for seq, y_m in ((0, 0.0), (2, 0.0), (1, 4.0)):
        kf = keyframe(seq)
        T = transform(np.eye(3), [0.0, y_m, 0.0])
        track.insert(Keyframe(kf.id, kf.stamp_ns, T, kf.camera_hash, None))
    assert track.distances(0).metres.tolist() == [0.0, 4.0, 8.0]


def test_slots_follow_their_keyframe() -> None:
    track = track_of([4])
    track.set_slot(4, 7)
    track.insert(keyframe(2))
    track.set_slot(2, 9)
    assert dict(zip(track.seqs, track.slots, strict=True)) == {2: 9, 4: 7}


def test_a_keyframe_twice_or_unknown_is_an_error() -> None:
    track = track_of([3])
    with pytest.raises(ValueError, match="logged twice"):
        track.insert(keyframe(3))
    with pytest.raises(KeyError):
        track.member(2)


def test_history_is_in_order_of_seq() -> None:
    history = QueryHistory()
    for seq in (5, 1, 3):
        history.add(PastQuery(seq, ()), productive=seq != 3)
    assert [past.seq for past in history.preceding(5, 2)] == [1, 3]
    assert [past.seq for past in history.preceding(4, 5)] == [1, 3]
    assert history.preceding(1, 5) == []
    assert history.productive == [1, 5]
