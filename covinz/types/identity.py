"""Names that last, and the arrays of frozen values."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AGENT_PATTERN = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
ULID_PATTERN = re.compile(r"[0-7][0-9A-HJKMNP-TV-Z]{25}")
_SEQ_PATTERN = re.compile(r"0|[1-9][0-9]{0,18}")


def frozen_array(
    values: object, shape: tuple[int | None, ...], dtype: str = "f8"
) -> NDArray[np.generic]:
    """Return a read-only, C-contiguous copy of `values` after checking its shape.

    Args:
        values: Anything that numpy makes an array of.
        shape: Wanted shape; None accepts any length of that axis.
        dtype: Wanted element type.

    Raises:
        ValueError: If the shape differs, or an integer or boolean array cannot hold the values.
    """
    source = np.asarray(values)
    is_wanted = source.dtype == np.dtype(dtype)
    array = source.copy(order="C") if is_wanted else _converted(source, dtype)
    if array.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        raise ValueError(f"expected an array of shape {shape}, got {array.shape}")
    array.setflags(write=False)
    return array


def _converted(source: NDArray[np.generic], dtype: str) -> NDArray[np.generic]:
    with np.errstate(invalid="ignore", over="ignore"):
        array: NDArray[np.generic] = source.astype(dtype, order="C", copy=True)
    if array.dtype.kind in "iub" and np.any(array != source):
        raise ValueError(f"not all values are {array.dtype}")
    return array


@dataclass(frozen=True, slots=True, order=True)
class KeyframeId:
    """Names one keyframe for ever.

    Attributes:
        agent: Robot, matches ``[a-z0-9][a-z0-9_-]{0,31}``.
        session: ULID of one uninterrupted run of the robot's odometry.
        seq: Counts the keyframes of the session from 0 without gaps.
    """

    agent: str
    session: str
    seq: int

    def __str__(self) -> str:
        return f"{self.agent}/{self.session}/{self.seq}"

    @property
    def segment(self) -> SegmentId:
        """The segment this keyframe belongs to."""
        return SegmentId(self.agent, self.session)

    @classmethod
    def parse(cls, text: str) -> KeyframeId:
        """Read ``agent/session/seq``; raises ValueError when `text` is anything else."""
        agent, session, seq = text.split("/") if text.count("/") == 2 else ("", "", "")
        well_formed = AGENT_PATTERN.fullmatch(agent) and ULID_PATTERN.fullmatch(session)
        if not (well_formed and _SEQ_PATTERN.fullmatch(seq) and int(seq) < 2**63):
            raise ValueError(f"not a keyframe id: {text!r}")
        return cls(agent, session, int(seq))


@dataclass(frozen=True, slots=True, order=True)
class SegmentId:
    """One agent's keyframes of one session: what odometry alone holds together."""

    agent: str
    session: str

    def __str__(self) -> str:
        return f"{self.agent}/{self.session}"
