"""Trajectories and their files in the TUM format: ``timestamp tx ty tz qx qy qz qw``.

Time stamps are decimal seconds in the file and integer nanoseconds here; they never pass through
a float, which cannot hold nanoseconds of Unix time.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from covinz import frames
from covinz.types import Array, frozen_array

_STAMP = re.compile(r"([0-9]{1,10})(?:\.([0-9]*))?")


class TrajectoryError(ValueError):
    """A trajectory file that cannot be used; the message names file and line."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses of one moving frame over time.

    Attributes:
        stamps_ns: (N,) int64, strictly ascending.
        T_ref_body: (N, 4, 4) poses of the moving frame in a fixed one; which frames these are,
            the owner knows.

    Raises:
        ValueError: If the shapes disagree or the stamps do not ascend.
    """

    stamps_ns: NDArray[np.int64]
    T_ref_body: Array

    def __post_init__(self) -> None:
        stamps = frozen_array(self.stamps_ns, (None,), "i8")
        if np.any(np.diff(stamps) <= 0):
            raise ValueError("the stamps of a trajectory must ascend")
        object.__setattr__(self, "stamps_ns", stamps)
        object.__setattr__(self, "T_ref_body", frozen_array(self.T_ref_body, (len(stamps), 4, 4)))

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def at(self, stamp_ns: int, max_gap_ns: int) -> Array | None:
        """Pose (4, 4) at a time, exact or interpolated; None where there is none.

        Args:
            stamp_ns: Wanted time.
            max_gap_ns: Poses further apart than this are not interpolated between.
        """
        after = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if after < len(self) and self.stamps_ns[after] == stamp_ns:
            exact: Array = self.T_ref_body[after]
            return exact
        if after in (0, len(self)):
            return None
        start, end = int(self.stamps_ns[after - 1]), int(self.stamps_ns[after])
        if end - start > max_gap_ns:
            return None
        fraction = (stamp_ns - start) / (end - start)
        return frames.interpolate(self.T_ref_body[after - 1], self.T_ref_body[after], fraction)

    def sample(self, stamps_ns: ArrayLike, max_gap_ns: int) -> tuple[Array, NDArray[np.intp]]:
        """`at` for many times: poses (K, 4, 4) and the indices (K,) of the times that have one."""
        poses = [self.at(int(t), max_gap_ns) for t in np.asarray(stamps_ns, dtype=np.int64)]
        found = [(i, T) for i, T in enumerate(poses) if T is not None]
        indices = np.array([i for i, _ in found], dtype=np.intp)
        return np.array([T for _, T in found]).reshape(-1, 4, 4), indices


def parse_stamp_ns(text: str) -> int:
    """Nanoseconds of a time stamp in decimal seconds; digits beyond nanoseconds round half up.

    Raises:
        ValueError: If `text` is anything else, e.g. negative or with an exponent, or too large.
    """
    match = _STAMP.fullmatch(text)
    if match is None:
        raise ValueError(f"not a time stamp in decimal seconds: {text!r}")
    digits = (match[2] or "").ljust(10, "0")
    stamp_ns = int(match[1]) * 1_000_000_000 + int(digits[:9]) + (digits[9] >= "5")
    if stamp_ns >= 2**63:
        raise ValueError(f"not a time stamp before the year 2262: {text!r}")
    return stamp_ns


def format_stamp_ns(stamp_ns: int) -> str:
    """Decimal seconds with nine places; inverse of `parse_stamp_ns`."""
    seconds, nanoseconds = divmod(int(stamp_ns), 1_000_000_000)
    return f"{seconds}.{nanoseconds:09d}"


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory file; lines that are empty or start with ``#`` are skipped.

    Raises:
        TrajectoryError: If the file cannot be read, a line is not eight finite numbers, a
            quaternion has not about unit length or the stamps do not ascend.
    """
    stamps: list[int] = []
    poses: list[list[float]] = []
    for number, words in table(path):
        where = f"{path}:{number}"
        if len(words) != 8:
            raise TrajectoryError(f"{where}: expected 8 columns, got {len(words)}")
        try:
            stamp, pose = parse_stamp_ns(words[0]), [float(word) for word in words[1:]]
        except ValueError as error:
            raise TrajectoryError(f"{where}: {error}") from error
        if not np.isfinite(pose).all() or abs(float(np.linalg.norm(pose[3:])) - 1) > 0.01:
            raise TrajectoryError(f"{where}: not a finite pose with a unit quaternion x y z w")
        if stamps and stamp <= stamps[-1]:
            raise TrajectoryError(f"{where}: the time stamps must ascend")
        stamps.append(stamp)
        poses.append(pose)
    return Trajectory(
        np.array(stamps, dtype=np.int64),
        frames.transform_from_pose(np.array(poses).reshape(-1, 7)),
    )


def write_tum(path: Path, trajectory: Trajectory, comment: str = "") -> None:
    """Write a trajectory file that `read_tum` and the usual tools read.

    Args:
        path: File to make or replace.
        trajectory: What to write.
        comment: Its lines head the file after ``#``.
    """
    lines = [f"# {line}" for line in comment.splitlines()]
    poses = frames.pose_from_transform(trajectory.T_ref_body)
    for stamp_ns, pose in zip(trajectory.stamps_ns, poses, strict=True):
        lines.append(f"{format_stamp_ns(stamp_ns)} " + " ".join(f"{value:.9f}" for value in pose))
    path.write_text("\n".join([*lines, ""]))


def table(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line numbers (from 1) and words of a text table without its comments and empty lines.

    Raises:
        TrajectoryError: If the file cannot be read.
    """
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise TrajectoryError(f"cannot read {path}: {error}") from error
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if words and not words[0].startswith("#"):
            yield number, words
