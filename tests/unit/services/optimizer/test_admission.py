"""Every way in which a loop can be unusable has its typed answer."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from covinz import codec
from covinz.frames import Array
from covinz.types import Gap, LoopClosure, Rejected
from services.optimizer.admission import Code, admit
from tests.fleets import closure, keyframe

A, B = keyframe("a", 0, 3).id, keyframe("b", 1, 4).id


def test_a_good_loop_is_admitted_as_it_is() -> None:
    loop = admit(codec.encode(closure(A, B)))
    assert isinstance(loop, LoopClosure)
    assert (loop.query, loop.cand, loop.job_id) == (A, B, closure(A, B).job_id)
    np.testing.assert_allclose(loop.covariance, closure(A, B).covariance)


def far() -> LoopClosure:
    T = np.eye(4)
    T[0, 3] = 1e5
    return closure(A, B, T)


def with_covariance(matrix: Array) -> LoopClosure:
    return dataclasses.replace(closure(A, B), covariance=matrix)


@pytest.mark.parametrize(
    ("payload", "code"),
    [
        (b"", Code.MALFORMED),
        (b"\xff" * 400, Code.MALFORMED),
        (codec.encode(closure(A, B))[:-40], Code.MALFORMED),
        (codec.encode(Gap("a", A.session, 0, 1, "spool")), Code.MALFORMED),
        (codec.encode(closure(A, A)), Code.SELF_LOOP),
        (codec.encode(far()), Code.BAD_POSE),
        (codec.encode(with_covariance(np.diag([1, 1, 1, 1, 1, 1e-11]))), Code.BAD_COVARIANCE),
        (codec.encode(with_covariance(1e-13 * np.eye(6))), Code.BAD_COVARIANCE),
    ],
)
def test_a_bad_loop_is_rejected_with_the_check_that_failed(payload: bytes, code: Code) -> None:
    answer = admit(payload)
    assert isinstance(answer, Rejected)
    assert answer.code == code.value
    assert answer.reason
