"""Members of rigs are written and read all at once, and to the bit as one by one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz.codec import poses, values
from covinz.codec.reader import Fields
from covinz.codec.rigs import MAX_TWIST, rig_fields, rigs_of
from covinz.types import Array, KeyframeId, RigMember
from tests.unit.covinz.messages import poses_of

SESSION = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
BAD_POSE = np.diag([1.0, 1.0, -1.0, 1.0])
FAR = np.eye(4) + 1e10 * np.eye(4, k=3)


def member(rng: np.random.Generator, seq: int) -> RigMember:
    root = rng.normal(size=(6, 6)) * rng.choice([1e-3, 1.0, 1e3])
    covariance = root @ root.T + np.eye(6) * np.trace(root @ root.T)
    return RigMember(
        KeyframeId("robot", SESSION, seq),
        poses_of(rng),
        "00112233aabbccdd",
        (covariance + covariance.T) / 2 if rng.random() < 0.8 else None,
        rng.uniform(-MAX_TWIST, MAX_TWIST, (2, 6)) if rng.random() < 0.8 else None,
    )


def rig(seed: int, size: int) -> list[RigMember]:
    rng = np.random.default_rng(seed)
    return [member(rng, seq) for seq in range(size)]


def bits(array: Any) -> bytes | None:
    return None if array is None else np.asarray(array, dtype=np.float64).tobytes()


def one_by_one(member: RigMember) -> tuple[bytes | None, ...]:
    """What travels of a member, each value checked by itself."""
    covariance, twists = member.motion_covariance, member.twists
    pose = poses.pose_values(member.T_odom_body, "T_odom_body")
    return (
        bits(pose),
        bits(covariance if covariance is None else values.covariance(covariance, "c", True)),
        bits(twists if twists is None else values.numbers(twists, "t", 12, MAX_TWIST)),
        bits(poses.transforms(pose, "T_odom_body")),
    )


@given(st.integers(0, 2**32), st.integers(1, 8), st.integers(1, 8))
def test_all_at_once_is_one_by_one_to_the_bit(seed: int, num_query: int, num_cand: int) -> None:
    both = rig(seed, num_query + num_cand)
    fields = rig_fields(both[:num_query], both[num_query:])
    back = rigs_of(*fields)
    assert [len(one) for one in back] == [num_query, num_cand]
    wires, members = [*fields[0], *fields[1]], [*back[0], *back[1]]
    for sent, wire, received in zip(both, wires, members, strict=True):
        assert one_by_one(sent) == (
            bits(wire["pose_odom_body"]),
            bits(wire["motion_covariance"]),
            bits(wire["twists"]),
            bits(received.T_odom_body),
        )
        assert received.keyframe == sent.keyframe
        assert bits(received.motion_covariance) == bits(sent.motion_covariance)
        assert bits(received.twists) == bits(sent.twists)


def error_of(call: Callable[[], object]) -> str:
    with pytest.raises(ValueError) as caught:
        call()
    return str(caught.value)


def asymmetric() -> Array:
    return np.eye(6) + 1e-3 * np.eye(6, k=1)


BAD_MEMBERS: list[dict[str, Any]] = [
    {"T_odom_body": BAD_POSE},
    {"T_odom_body": FAR},
    {"T_odom_body": np.full((4, 4), np.nan)},
    {"motion_covariance": asymmetric()},
    {"motion_covariance": -np.eye(6)},
    {"motion_covariance": np.eye(6) * np.nan},
    {"motion_covariance": np.eye(6) * 1e19},
    {"twists": np.full((2, 6), 2 * MAX_TWIST)},
    {"twists": np.full((2, 6), np.inf)},
    {"camera_hash": "00112233AABBCCDD"},
    {"keyframe": KeyframeId("Robot", SESSION, 0)},
]


@pytest.mark.parametrize("change", BAD_MEMBERS)
def test_a_bad_member_is_refused_as_if_it_were_alone(change: dict[str, Any]) -> None:
    good = rig(1, 8)
    bad = dataclasses.replace(good[0], **change)
    alone = error_of(lambda: rig_fields([bad]))
    for at in range(8):
        members = [*good[:at], bad, *good[at:]]
        assert error_of(partial(rig_fields, members[:4], members[4:])) == alone


BAD_FIELDS: list[Fields] = [
    {"pose_odom_body": (np.nan, 0, 0, 0, 0, 0, 1)},
    {"pose_odom_body": (0, 2e9, 0, 0, 0, 0, 1)},
    {"pose_odom_body": (0, 0, 0, 0, 0, 0, 1.1)},
    {"pose_odom_body": (0, 0, 0, np.nan, 0, 0, 1)},
    {"motion_covariance": np.ones(35)},
    {"motion_covariance": asymmetric().ravel()},
    {"motion_covariance": -np.eye(6).ravel()},
    {"twists": np.ones(13)},
    {"twists": np.full(12, np.nan)},
    {"camera_hash": ""},
    {"keyframe": {"agent": "robot", "session": SESSION, "seq": 2**63}},
]


@pytest.mark.parametrize("change", BAD_FIELDS)
def test_a_bad_member_is_not_read_as_if_it_were_alone(change: Fields) -> None:
    (good,) = rig_fields(rig(2, 8))
    bad = good[0] | change
    alone = error_of(lambda: rigs_of([bad]))
    for at in range(8):
        fields = [*good[:at], bad, *good[at:]]
        assert error_of(partial(rigs_of, fields[:4], fields[4:])) == alone


def test_rigs_are_not_empty() -> None:
    good = rig(3, 2)
    assert error_of(lambda: rig_fields(good, [])) == "a rig is empty"
    assert error_of(lambda: rigs_of([], rig_fields(good)[0])) == "a rig is empty"
