"""One session's keyframes as far as the log goes: neighbours, and distances along the path."""

from __future__ import annotations

from bisect import bisect_left, insort
from dataclasses import dataclass

import covinz_core
import numpy as np
from numpy.typing import NDArray

from covinz.config import OdometryNoise
from covinz.types import Array, Keyframe, KeyframeId, RigMember, SegmentId


@dataclass(frozen=True, slots=True, eq=False)
class PathDistances:
    """How far every keyframe of a session is from one of them, along the session.

    Attributes:
        keyframes: (N,) difference of sequence numbers.
        seconds: (N,) difference of time stamps [s].
        metres: (N,) length of the odometry's path through the keyframes logged so far [m].
    """

    keyframes: NDArray[np.int64]
    seconds: Array
    metres: Array


class Track:
    """The logged keyframes of one session in order of `seq`, whatever the order of arrival.

    `slots` holds each keyframe's place in the index, -1 for one that was never put in; `path` has
    all keyframes of the session, also those that take no part in place recognition.

    Args:
        segment: The session.
        noise: Accuracy of a front-end that nothing is known of.
    """

    def __init__(self, segment: SegmentId, noise: OdometryNoise) -> None:
        self.segment = segment
        self.path = covinz_core.OdometryPath(covinz_core.OdometryNoise(**noise.model_dump()))
        self.seqs: list[int] = []
        self.slots: list[int] = []
        self._members: list[RigMember] = []
        self._stamps_ns: list[int] = []
        self._path_m: list[float] = []

    def __len__(self) -> int:
        return len(self.seqs)

    def __contains__(self, seq: int) -> bool:
        at = bisect_left(self.seqs, seq)
        return at < len(self.seqs) and self.seqs[at] == seq

    def insert(self, kf: Keyframe) -> None:
        """Add a keyframe; raises ValueError when it is there already."""
        if kf.id.seq in self:
            raise ValueError(f"{kf.id} is logged twice")
        at = bisect_left(self.seqs, kf.id.seq)
        self.seqs.insert(at, kf.id.seq)
        self.slots.insert(at, -1)
        self._members.insert(at, RigMember(kf.id, kf.T_odom_body, kf.camera_hash))
        self._stamps_ns.insert(at, kf.stamp_ns)
        self._path_m.insert(at, 0.0)
        self._measure_from(at)

    def set_slot(self, seq: int, slot: int) -> None:
        """Note where the index keeps a keyframe of the session."""
        self.slots[self._position(seq)] = slot

    def member(self, seq: int) -> RigMember:
        """A keyframe of the session as a camera of a rig."""
        return self._members[self._position(seq)]

    def before(self, seq: int, count: int) -> tuple[RigMember, ...]:
        """Up to `count` nearest logged predecessors, the nearest first."""
        at = self._position(seq)
        return tuple(reversed(self._members[max(0, at - count) : at]))

    def after(self, seq: int, count: int) -> tuple[RigMember, ...]:
        """Up to `count` nearest logged successors, the nearest first."""
        at = self._position(seq)
        return tuple(self._members[at + 1 : at + 1 + count])

    def around(self, seq: int, count: int) -> tuple[RigMember, ...]:
        """A keyframe and up to `count` nearest logged ones on either side, in order of time."""
        at = self._position(seq)
        return tuple(self._members[max(0, at - count) : at + count + 1])

    def distances(self, seq: int) -> PathDistances:
        """Distances of all keyframes of the session, in the order of `seqs`, from one of them."""
        at = self._position(seq)
        seqs, stamps_ns = np.array(self.seqs), np.array(self._stamps_ns)
        path_m = np.array(self._path_m)
        return PathDistances(
            keyframes=np.abs(seqs - seqs[at]),
            seconds=np.abs(stamps_ns - stamps_ns[at]) * 1e-9,
            metres=np.abs(path_m - path_m[at]),
        )

    def _position(self, seq: int) -> int:
        at = bisect_left(self.seqs, seq)
        if at == len(self.seqs) or self.seqs[at] != seq:
            raise KeyError(f"{self.segment}/{seq} is not logged")
        return at

    def _measure_from(self, at: int) -> None:
        """Bring the path lengths of the keyframes from position `at` on up to date."""
        for i in range(at, len(self.seqs)):
            step_m = 0.0
            if i > 0:
                here, there = self._members[i].T_odom_body, self._members[i - 1].T_odom_body
                step_m = float(np.linalg.norm(here[:3, 3] - there[:3, 3]))
            self._path_m[i] = (self._path_m[i - 1] if i > 0 else 0.0) + step_m


@dataclass(frozen=True, slots=True)
class PastQuery:
    """What an earlier query of a session found, before the guard of consistency."""

    seq: int
    candidates: tuple[KeyframeId, ...]


class QueryHistory:
    """The queries of one session so far, and which of them gave loop candidates."""

    def __init__(self) -> None:
        self._queries: list[PastQuery] = []
        self.productive: list[int] = []

    def add(self, query: PastQuery, productive: bool) -> None:
        """Note a query; `productive` when candidates were left after all guards."""
        insort(self._queries, query, key=lambda past: past.seq)
        if productive:
            insort(self.productive, query.seq)

    def preceding(self, seq: int, count: int) -> list[PastQuery]:
        """Up to `count` queries nearest before `seq`."""
        at = bisect_left(self._queries, seq, key=lambda past: past.seq)
        return self._queries[max(0, at - count) : at]
