"""The keyframes of a job's rigs: all that are checked alike are checked in one go.

Bytes and values are those of one member at a time; only numpy is asked fewer times.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from covinz.codec import poses, values
from covinz.codec.reader import Fields
from covinz.types import RigMember

M = TypeVar("M")

# [rad/s, m/s]: nothing of what place recognition says of a robot is faster.
MAX_TWIST: Final = 1e3


def rig_fields(*rigs: Sequence[RigMember]) -> list[list[Fields]]:
    """Fields of the members of rigs, none of them empty."""
    members = _joined(rigs)
    T_odom_body = np.stack([member.T_odom_body for member in members])
    pose_odom_body = poses.pose_values(T_odom_body, "T_odom_body").tolist()
    covariances = _covariances([member.motion_covariance for member in members])
    twists = _twists([member.twists for member in members])
    fields = [
        {
            "keyframe": values.keyframe_id_fields(member.keyframe),
            "pose_odom_body": tuple(pose),
            "camera_hash": values.text(member.camera_hash, "camera_hash", values.CAMERA_HASH),
            "motion_covariance": covariance,
            "twists": twist,
        }
        for member, pose, covariance, twist in zip(
            members, pose_odom_body, covariances, twists, strict=True
        )
    ]
    return _split(fields, rigs)


def rigs_of(*rigs: list[Fields]) -> list[tuple[RigMember, ...]]:
    """The inverse of `rig_fields`."""
    fields = _joined(rigs)
    T_odom_body = poses.transforms([member["pose_odom_body"] for member in fields], "T_odom_body")
    covariances = _covariances([member["motion_covariance"] for member in fields])
    twists = _twists([member["twists"] for member in fields])
    members = [
        RigMember(
            values.keyframe_id(member["keyframe"]),
            T,
            values.text(member["camera_hash"], "camera_hash", values.CAMERA_HASH),
            None if covariance is None else covariance.reshape(6, 6),
            None if twist is None else twist.reshape(2, 6),
        )
        for member, T, covariance, twist in zip(
            fields, T_odom_body, covariances, twists, strict=True
        )
    ]
    return [tuple(rig) for rig in _split(members, rigs)]


def _joined(rigs: Sequence[Sequence[M]]) -> list[M]:
    if not all(rigs):
        raise ValueError("a rig is empty")
    return [member for rig in rigs for member in rig]


def _split(members: Sequence[M], like: Sequence[Sequence[object]]) -> list[list[M]]:
    remaining = iter(members)
    return [[next(remaining) for _ in rig] for rig in like]


def _covariances(given: Sequence[ArrayLike | None]) -> list[NDArray[Any] | None]:
    present = [covariance for covariance in given if covariance is not None]
    return _where_given(given, values.covariances(present, "motion_covariance"))


def _twists(given: Sequence[ArrayLike | None]) -> list[NDArray[Any] | None]:
    present = [twists for twists in given if twists is not None]
    return _where_given(given, values.rows(present, "twists", 12, MAX_TWIST))


def _where_given(given: Sequence[object], rows: NDArray[Any]) -> list[NDArray[Any] | None]:
    remaining = iter(rows)
    return [None if one is None else next(remaining) for one in given]
