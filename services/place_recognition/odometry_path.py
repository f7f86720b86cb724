"""What a session's odometry said, keyframe by keyframe, of all that are logged."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

import numpy as np

from covinz.config import OdometryNoise
from covinz.frames import local_error
from covinz.odometry import MotionStep, compounded, motion_step
from covinz.types import Array, Keyframe

# Keyframes nearer in time say more about odometry's noise than about a twist. [s]
_MIN_STEP_S = 5e-3
# No robot is faster, only odometry that jumps. [rad/s, m/s]
_MAX_TWIST = 100.0


class OdometryPath:
    """Poses and covariances of a session in order of `seq`, whatever the order of arrival.

    Keyframes that take no part in place recognition are steps of the path all the same. What only
    depends on neighbours is kept: many rigs lie over the same steps.

    Args:
        noise: The front-end's usual accuracy.
    """

    def __init__(self, noise: OdometryNoise) -> None:
        self._noise = noise
        self._seqs: list[int] = []
        self._keyframes: list[tuple[Array, Array | None]] = []
        self._stamps_ns: list[int] = []
        # Of each keyframe, once they are known: the step to it, and its twists.
        self._steps: list[MotionStep | None] = []
        self._twists: list[Array | None] = []

    def insert(self, kf: Keyframe) -> None:
        """Add a keyframe; raises ValueError when it is there already."""
        at = bisect_left(self._seqs, kf.id.seq)
        if kf.id.seq in self._seqs[at : at + 1]:
            raise ValueError(f"{kf.id} is logged twice")
        self._seqs.insert(at, kf.id.seq)
        self._keyframes.insert(at, (kf.T_odom_body, kf.covariance))
        self._stamps_ns.insert(at, kf.stamp_ns)
        self._steps.insert(at, None)
        self._twists.insert(at, None)
        # Its neighbours have another neighbour now.
        for other in range(max(0, at - 1), min(at + 2, len(self._seqs))):
            self._steps[other] = self._twists[other] = None

    def num_after(self, seq: int) -> int:
        """How many logged keyframes follow on one."""
        return len(self._seqs) - bisect_right(self._seqs, seq)

    def state(self, last: int) -> tuple[int, ...]:
        """As long as it stays equal, so do all motions and twists up to a logged keyframe.

        A path only ever grows, so the number of keyframes up to that one says which they are; the
        one that follows gives it its second twist.
        """
        count = bisect_right(self._seqs, last)
        return (count, *self._seqs[count : count + 1])

    def covariance(self, first: int, last: int) -> Array:
        """(6, 6) covariance of the motion between two logged keyframes, in the later body frame.

        A step over keyframes that are missing has none of the robot's: that speaks of the motion
        since seq - 1 only.
        """
        begin, end = bisect_left(self._seqs, first), bisect_right(self._seqs, last)
        return compounded([self._step(at) for at in range(begin + 1, end)], self._noise)

    def twists(self, seq: int) -> Array | None:
        """(2, 6) how the body moved before and after a logged keyframe, [rad/s, m/s] in its frame.

        The means over the steps to its neighbours; where there is one at one side only, it stands
        for both. None without any neighbour at another time.
        """
        at = bisect_left(self._seqs, seq)
        twists = self._twists[at]
        if twists is None:
            twists = self._twists[at] = self._new_twists(at)
        return twists

    def _step(self, at: int) -> MotionStep:
        """The step to the keyframe at a position from the one before."""
        step = self._steps[at]
        if step is None:
            (T_prev, _), (T_cur, sent) = self._keyframes[at - 1 : at + 1]
            is_next = self._seqs[at] == self._seqs[at - 1] + 1
            step = motion_step(T_prev, T_cur, sent if is_next else None, self._noise)
            self._steps[at] = step
        return step

    def _new_twists(self, at: int) -> Array | None:
        before, after = self._mean_twist(at, at - 1), self._mean_twist(at, at + 1)
        if before is None:
            before = after
        if after is None:
            after = before
        if before is None or after is None:
            return None
        twists = np.stack([before, after])
        twists.setflags(write=False)  # everybody gets the same
        return twists

    def _mean_twist(self, at: int, other: int) -> Array | None:
        if not 0 <= other < len(self._seqs):
            return None
        seconds = 1e-9 * (self._stamps_ns[other] - self._stamps_ns[at])
        if abs(seconds) < _MIN_STEP_S:
            return None
        twist = local_error(self._keyframes[at][0], self._keyframes[other][0]) / seconds
        return twist * min(1.0, _MAX_TWIST / max(float(np.abs(twist).max()), _MAX_TWIST))
