"""A segment: one session's keyframes as arrays, however they arrived."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from covinz.frames import Array
from covinz.types import Keyframe, KeyframeId, SegmentId


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """What odometry alone holds together; rows in order of `seq`, which may have holes.

    Attributes:
        id: Agent and session.
        seq: (N,) int64, ascending.
        log_index: (N,) int64 place of each keyframe in the log.
        stamp_ns: (N,) int64.
        T_odom_body: (N, 4, 4) as the agent sent them.
        covariance: (N, 6, 6) of the motion since keyframe seq - 1 as the agent sent it; NaN where
            it sent none.
    """

    id: SegmentId
    seq: NDArray[np.int64]
    log_index: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    T_odom_body: Array
    covariance: Array

    def __len__(self) -> int:
        return len(self.seq)

    @property
    def first_log_index(self) -> int:
        """Log index of the keyframe that arrived first; orders segments by age."""
        return int(self.log_index.min())

    def rows(self, seqs: NDArray[np.int64]) -> NDArray[np.int64]:
        """Rows of keyframes by their `seq`; raises KeyError when the segment lacks one."""
        rows = np.searchsorted(self.seq, seqs)
        missing = seqs[self.seq[np.minimum(rows, len(self.seq) - 1)] != seqs]
        if len(missing):
            raise KeyError(f"{self.id} has no keyframe {missing[0]}")
        return rows


@dataclass(slots=True)
class GrowingSegment:
    """The keyframes of one session as they arrive, in any order of `seq`."""

    id: SegmentId
    _rows: dict[int, tuple[int, Keyframe]] = field(default_factory=dict)
    _frozen: Segment | None = None

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, keyframe: KeyframeId) -> bool:
        return keyframe.segment == self.id and keyframe.seq in self._rows

    @property
    def first_log_index(self) -> int:
        """Log index of the keyframe that arrived first; raises StopIteration when empty."""
        return next(iter(self._rows.values()))[0]

    def add(self, log_index: int, keyframe: Keyframe) -> None:
        """Take a keyframe; a second one of the same name is ignored."""
        if keyframe.id.seq not in self._rows:
            self._rows[keyframe.id.seq] = (log_index, keyframe)
            self._frozen = None

    def frozen(self) -> Segment:
        """The keyframes so far; depends on which there are, not on how they came."""
        if self._frozen is None:
            rows = [self._rows[seq] for seq in sorted(self._rows)]
            unknown = np.full((6, 6), np.nan)
            self._frozen = Segment(
                id=self.id,
                seq=np.array([kf.id.seq for _, kf in rows], dtype=np.int64),
                log_index=np.array([index for index, _ in rows], dtype=np.int64),
                stamp_ns=np.array([kf.stamp_ns for _, kf in rows], dtype=np.int64),
                T_odom_body=np.array([kf.T_odom_body for _, kf in rows]),
                covariance=np.array(
                    [unknown if kf.covariance is None else kf.covariance for _, kf in rows]
                ),
            )
        return self._frozen
