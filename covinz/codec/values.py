"""Checks of single values, the same on the way out (ValueError) and in (MalformedMessage)."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from covinz.codec.reader import Fields
from covinz.types import AGENT_PATTERN, ULID_PATTERN, KeyframeId, SegmentId

# Integers on the wire fit SQLite's and numpy's signed 64 bits.
MAX_INT: Final = 2**63 - 1
MAX_COUNT: Final = 2**32 - 1
# Largest entry of a covariance: the square of the largest coordinate. [m^2]
MAX_COVARIANCE: Final = 1e18
SYMMETRY_TOLERANCE: Final = 1e-9

CAMERA_HASH = re.compile(r"[0-9a-f]{16}")
JOB_ID = re.compile(r"[0-9a-f]{32}")
CODE = re.compile(r"[a-z][a-z0-9_]{0,63}")
VERSION = re.compile(r"[0-9a-z.+-]{1,64}")
# One part of a Zenoh key expression.
INSTANCE = re.compile(r"[^/*$?#\s\x00-\x1f]{1,128}")
_CHAIN: Final = re.compile(r"[0-9a-f]{32}")


def whole(value: Any, name: str, low: int = 0, high: int = MAX_INT) -> int:
    """An integer within [low, high]."""
    try:
        number = operator.index(value)
    except TypeError as error:
        raise ValueError(f"{name}: {value!r} is not an integer") from error
    if not low <= number <= high:
        raise ValueError(f"{name}: {number} is not within [{low}, {high}]")
    return number


def maybe_log_id(value: str | None) -> str | None:
    """A ULID; None when nobody said which log it is."""
    return text(value, "log_id", re.compile(ULID_PATTERN)) if value else None


def maybe_chain(value: str | None) -> str | None:
    """A hash over a log; None when unknown."""
    return text(value, "chain", _CHAIN) if value else None


def finite(value: Any, name: str, low: float = -math.inf) -> float:
    """A finite number, not below `low`."""
    number = float(value)
    if not math.isfinite(number) or number < low:
        raise ValueError(f"{name}: {number} is not a finite number >= {low}")
    return number


def text(value: str, name: str, pattern: re.Pattern[str] | None = None) -> str:
    """A string, which matches `pattern` as a whole where one is given."""
    if not isinstance(value, str) or (pattern is not None and not pattern.fullmatch(value)):
        raise ValueError(f"{name}: {value!r} is not well formed")
    return value


def agent_id(value: str) -> str:
    """An agent id."""
    return text(value, "agent", AGENT_PATTERN)


def ulid(value: str, name: str) -> str:
    """A ULID: of a session, map or log."""
    return text(value, name, ULID_PATTERN)


def numbers(values: ArrayLike, name: str, length: int, bound: float = math.inf) -> NDArray[Any]:
    """`length` finite numbers, none larger than `bound`."""
    return _bounded(_of_length(values, name, length), name, bound)


def rows(
    given: Sequence[ArrayLike], name: str, length: int, bound: float = math.inf
) -> NDArray[Any]:
    """What `numbers` makes of each, (N, length), in one go."""
    arrays = [_of_length(values, name, length) for values in given]
    return _bounded(np.array(arrays).reshape(-1, length), name, bound)


def check_symmetric(matrices: NDArray[Any], name: str) -> None:
    """Raise ValueError unless all matrices (..., 6, 6) are symmetric within rounding."""
    scale = np.abs(matrices).max(axis=(-2, -1), keepdims=True, initial=0.0)
    asymmetry = np.abs(matrices - np.swapaxes(matrices, -1, -2))
    if np.any(asymmetry > SYMMETRY_TOLERANCE * scale):
        raise ValueError(f"{name}: not symmetric")


def covariance(values: ArrayLike, name: str, definite: bool) -> NDArray[Any]:
    """36 numbers of a symmetric positive (semi-)definite 6x6 matrix."""
    if definite:
        row: NDArray[Any] = covariances([values], name)[0]
        return row
    array = numbers(values, name, 36, MAX_COVARIANCE)
    matrix = array.reshape(6, 6)
    check_symmetric(matrix, name)
    if np.linalg.eigvalsh(matrix)[0] < -SYMMETRY_TOLERANCE * np.abs(matrix).max():
        raise ValueError(f"{name}: not positive semi-definite")
    return array


def covariances(given: Sequence[ArrayLike], name: str) -> NDArray[Any]:
    """(N, 36) numbers of symmetric positive definite 6x6 matrices, checked in one go."""
    arrays = rows(given, name, 36, MAX_COVARIANCE)
    matrices = arrays.reshape(-1, 6, 6)
    check_symmetric(matrices, name)
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError as error:
        raise ValueError(f"{name}: not positive definite") from error
    return arrays


def _of_length(values: ArrayLike, name: str, length: int) -> NDArray[Any]:
    array = np.asarray(values, dtype=np.float64).ravel()
    if len(array) != length:
        raise ValueError(f"{name}: {len(array)} numbers instead of {length}")
    return array


def _bounded(array: NDArray[Any], name: str, bound: float) -> NDArray[Any]:
    if not (np.isfinite(array).all() and (np.abs(array) <= bound).all()):
        raise ValueError(f"{name}: a number is not finite or beyond {bound:g}")
    return array


def keyframe_id_fields(value: KeyframeId) -> Fields:
    """Fields of a KeyframeId."""
    return {
        "agent": agent_id(value.agent),
        "session": ulid(value.session, "session"),
        "seq": whole(value.seq, "seq"),
    }


def keyframe_id(fields: Fields) -> KeyframeId:
    """The inverse of `keyframe_id_fields`."""
    agent, session = agent_id(fields["agent"]), ulid(fields["session"], "session")
    return KeyframeId(agent, session, whole(fields["seq"], "seq"))


def segment_id_fields(value: SegmentId) -> Fields:
    """Fields of a SegmentId."""
    return {"agent": agent_id(value.agent), "session": ulid(value.session, "session")}


def segment_id(fields: Fields) -> SegmentId:
    """The inverse of `segment_id_fields`."""
    return SegmentId(agent_id(fields["agent"]), ulid(fields["session"], "session"))
