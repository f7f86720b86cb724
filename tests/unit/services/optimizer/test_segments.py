"""Segments are a function of their keyframes, however these came."""

from __future__ import annotations

import numpy as np
import pytest

from covinz.types import Keyframe
from services.optimizer.segments import GrowingSegment
from tests.fleets import keyframe


def grown(keyframes: list[tuple[int, Keyframe]]) -> GrowingSegment:
    segment = GrowingSegment(keyframes[0][1].id.segment)
    for index, kf in keyframes:
        segment.add(index, kf)
    return segment


def test_rows_are_in_order_of_seq_whatever_the_order_of_the_log() -> None:
    keyframes = [(10 * i, keyframe("a", 0, seq)) for i, seq in enumerate([3, 0, 7, 1])]
    segment = grown(keyframes).frozen()
    assert segment.seq.tolist() == [0, 1, 3, 7]
    assert segment.log_index.tolist() == [10, 30, 0, 20]
    assert segment.first_log_index == 0
    assert segment.rows(np.array([7, 0, 3, 1, 7])).tolist() == [3, 0, 2, 1, 3]


@pytest.mark.parametrize("seq", [2, 9])
def test_a_keyframe_that_is_not_there_has_no_row(seq: int) -> None:
    segment = grown([(0, keyframe("a", 0, 0)), (1, keyframe("a", 0, 3))])
    with pytest.raises(KeyError, match=f"no keyframe {seq}"):
        segment.frozen().rows(np.array([0, seq]))


def test_a_second_keyframe_of_the_same_name_is_ignored() -> None:
    T = np.eye(4)
    T[0, 3] = 5.0
    segment = grown([(0, keyframe("a", 0, 0)), (1, keyframe("a", 0, 0, T))])
    assert len(segment) == 1
    assert segment.frozen().T_odom_body[0, 0, 3] == 0.0


def test_what_was_frozen_does_not_grow() -> None:
    segment = grown([(0, keyframe("a", 0, 0))])
    before = segment.frozen()
    segment.add(1, keyframe("a", 0, 1))
    assert (len(before), len(segment.frozen())) == (1, 2)
    assert np.isnan(before.covariance).all()
