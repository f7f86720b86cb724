from __future__ import annotations

import covinz_core
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from covinz.config import OdometryNoise
from covinz.frames import so3_exp, transform
from covinz.types import Keyframe, KeyframeId

NOISE = covinz_core.OdometryNoise(**OdometryNoise().model_dump())
SENT = np.diag(np.arange(1.0, 7.0)) * 1e-5


def keyframe(seq: int) -> Keyframe:
    kf_id = KeyframeId("a", "01ARZ3NDEKTSV4RRFFQ69G5FAV", seq)
    T_odom_body = transform(np.eye(3), [np.cos(seq), np.sin(2 * seq), 0.1 * seq])
    return Keyframe(kf_id, seq * 500_000_000, T_odom_body, "0" * 16, None, SENT)


def insert(path: covinz_core.OdometryPath, kf: Keyframe) -> None:
    path.insert(kf.id.seq, kf.stamp_ns, kf.T_odom_body, kf.covariance)


def path_of(seqs: list[int]) -> covinz_core.OdometryPath:
    path = covinz_core.OdometryPath(NOISE)
    for seq in seqs:
        insert(path, keyframe(seq))
    return path


@given(st.permutations(range(8)))
def test_order_of_arrival_leaves_no_trace(arrival: list[int]) -> None:
    path, ordered = path_of(arrival), path_of(sorted(arrival))
    np.testing.assert_array_equal(path.covariance(1, 6), ordered.covariance(1, 6))
    assert [path.num_after(seq) for seq in range(8)] == list(range(7, -1, -1))


@settings(max_examples=20)
@given(st.permutations(range(8)))
def test_what_was_asked_before_leaves_no_trace(arrival: list[int]) -> None:
    asked = covinz_core.OdometryPath(NOISE)
    for count, seq in enumerate(arrival, start=1):
        insert(asked, keyframe(seq))
        known = sorted(arrival[:count])
        fresh = path_of(known)
        for one in known:
            np.testing.assert_array_equal(asked.twists(one), fresh.twists(one))
        if count > 1:
            ends = known[0], known[-1]
            np.testing.assert_array_equal(asked.covariance(*ends), fresh.covariance(*ends))


@settings(max_examples=20)
@given(st.permutations(range(8)))
def test_what_has_the_same_state_is_the_same(arrival: list[int]) -> None:
    path = covinz_core.OdometryPath(NOISE)
    found: dict[object, list[bytes]] = {}
    for count, seq in enumerate(arrival, start=1):
        insert(path, keyframe(seq))
        known = sorted(arrival[:count])
        for at, last in enumerate(known):
            twists = [path.twists(one) for one in known[: at + 1]]
            said = [b"" if each is None else each.tobytes() for each in twists]
            if at:
                said.append(path.covariance(known[0], last).tobytes())
            assert found.setdefault((last, path.state(last)), said) == said


def test_keyframes_that_follow_later_change_no_state() -> None:
    assert path_of([0, 1, 2]).state(1) == path_of([0, 1, 2, 3, 4]).state(1)
    assert path_of([0, 1, 2, 3]).state(1) != path_of([0, 1, 3]).state(1)
    assert path_of([0, 1]).state(1) != path_of([0, 1, 2]).state(1)


def test_every_keyframe_between_counts() -> None:
    T = [keyframe(seq).T_odom_body for seq in range(2, 6)]
    np.testing.assert_array_equal(
        path_of(list(range(9))).covariance(2, 5),
        covinz_core.motion_covariance(T, [SENT] * 3, NOISE),
    )


def test_over_missing_keyframes_the_robot_said_nothing() -> None:
    T = [keyframe(seq).T_odom_body for seq in (2, 3, 6)]
    np.testing.assert_array_equal(
        path_of([1, 2, 3, 6, 7]).covariance(2, 6),
        covinz_core.motion_covariance(T, [SENT, None], NOISE),
    )


def test_a_keyframe_twice_is_an_error() -> None:
    with pytest.raises(ValueError, match="logged twice"):
        path_of([1, 2, 1])


def turning(turns_rad: list[float], stamps_ms: list[int]) -> covinz_core.OdometryPath:
    """A body that moves ahead a centimetre a millisecond and turns about its z."""
    path = covinz_core.OdometryPath(NOISE)
    for seq, (turn_rad, stamp_ms) in enumerate(zip(turns_rad, stamps_ms, strict=True)):
        T = transform(so3_exp([0.0, 0.0, turn_rad]), [0.01 * stamp_ms, 0.0, 0.0])
        path.insert(seq, 1_000_000 * stamp_ms, T, None)
    return path


def test_twists_are_those_of_the_steps_before_and_after() -> None:
    # A turn of 0.1 rad in 0.1 s goes back at once, twice as fast.
    twists = turning([-0.1, 0.0, -0.1], [0, 100, 150]).twists(1)
    assert twists is not None
    want = [[0.0, 0.0, 1.0, 10.0, 0.0, 0.0], [0.0, 0.0, -2.0, 10.0, 0.0, 0.0]]
    np.testing.assert_allclose(twists, want, atol=1e-9)


def test_at_the_end_of_a_session_one_step_stands_for_both() -> None:
    path = turning([0.0, 0.1, 0.3], [0, 100, 200])
    first, last = path.twists(0), path.twists(2)
    assert first is not None and last is not None
    np.testing.assert_array_equal(first[0], first[1])
    np.testing.assert_allclose(last[:, 2], [2.0, 2.0])


def test_without_neighbours_at_other_times_nothing_is_said() -> None:
    assert turning([0.0], [0]).twists(0) is None
    assert turning([0.0, 0.5], [7, 7]).twists(0) is None


def test_odometry_that_jumps_is_no_robot() -> None:
    twists = turning([0.0, 3.0], [0, 5]).twists(0)
    assert twists is not None
    assert np.abs(twists).max() == pytest.approx(100.0)


def test_what_was_never_inserted_is_an_error() -> None:
    path = path_of([1, 2, 4])
    for ask in (lambda: path.state(3), lambda: path.twists(3), lambda: path.covariance(1, 3)):
        with pytest.raises(ValueError, match="3 is not logged"):
            ask()
    assert path.num_after(3) == 1
