from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz.config import OdometryNoise
from covinz.frames import transform
from covinz.odometry import motion_covariance
from covinz.types import Keyframe, KeyframeId
from services.place_recognition.odometry_path import OdometryPath

NOISE = OdometryNoise()
SENT = np.diag(np.arange(1.0, 7.0)) * 1e-5


def keyframe(seq: int) -> Keyframe:
    kf_id = KeyframeId("a", "01ARZ3NDEKTSV4RRFFQ69G5FAV", seq)
    T_odom_body = transform(np.eye(3), [np.cos(seq), np.sin(2 * seq), 0.1 * seq])
    return Keyframe(kf_id, seq, T_odom_body, "0" * 16, None, SENT)


def path_of(seqs: list[int]) -> OdometryPath:
    path = OdometryPath()
    for seq in seqs:
        path.insert(keyframe(seq))
    return path


@given(st.permutations(range(8)))
def test_order_of_arrival_leaves_no_trace(arrival: list[int]) -> None:
    path, ordered = path_of(arrival), path_of(sorted(arrival))
    np.testing.assert_array_equal(path.covariance(1, 6, NOISE), ordered.covariance(1, 6, NOISE))
    assert [path.num_after(seq) for seq in range(8)] == list(range(7, -1, -1))


def test_every_keyframe_between_counts() -> None:
    T = np.stack([keyframe(seq).T_odom_body for seq in range(2, 6)])
    np.testing.assert_array_equal(
        path_of(list(range(9))).covariance(2, 5, NOISE), motion_covariance(T, [SENT] * 3, NOISE)
    )


def test_over_missing_keyframes_the_robot_said_nothing() -> None:
    T = np.stack([keyframe(seq).T_odom_body for seq in (2, 3, 6)])
    np.testing.assert_array_equal(
        path_of([1, 2, 3, 6, 7]).covariance(2, 6, NOISE),
        motion_covariance(T, [SENT, None], NOISE),
    )


def test_a_keyframe_twice_is_an_error() -> None:
    with pytest.raises(ValueError, match="logged twice"):
        path_of([1, 2, 1])
