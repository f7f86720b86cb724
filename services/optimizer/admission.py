"""Which loops the optimizer takes: well formed, rigid, with a covariance that has an inverse."""

from __future__ import annotations

import enum

import numpy as np

from covinz import codec
from covinz.frames import is_rigid
from covinz.types import LoopClosure, Rejected

# Loops are metres long; beyond this numbers overflow before they mean anything. [m]
MAX_TRANSLATION_M = 1e4
# Smallest over largest eigenvalue of a covariance whose inverse is still accurate to six digits.
MIN_RECIPROCAL_CONDITION = 1e-10


class Code(enum.Enum):
    """Checks that a loop can fail."""

    MALFORMED = "malformed"
    SELF_LOOP = "self_loop"
    BAD_POSE = "bad_pose"
    BAD_COVARIANCE = "bad_covariance"


def admit(payload: bytes) -> LoopClosure | Rejected:
    """Read a loop closure as a worker sent it, or say what is wrong with it."""
    try:
        loop = codec.decode(payload, LoopClosure)
    except codec.MalformedMessage as error:
        return Rejected(Code.MALFORMED.value, str(error))
    if loop.query == loop.cand:
        return Rejected(Code.SELF_LOOP.value, f"{loop.query} is query and candidate")
    if not is_rigid(loop.T_cand_query) or np.abs(loop.T_cand_query).max() > MAX_TRANSLATION_M:
        reason = f"T_cand_query is not a rigid transform of at most {MAX_TRANSLATION_M:g} m"
        return Rejected(Code.BAD_POSE.value, reason)
    if not _is_covariance(loop.covariance):
        reason = "covariance is not symmetric positive definite and well conditioned"
        return Rejected(Code.BAD_COVARIANCE.value, reason)
    return loop


def _is_covariance(matrix: np.typing.NDArray[np.float64]) -> bool:
    if not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        return False
    eigenvalues = np.linalg.eigvalsh(matrix)
    return bool(eigenvalues[0] > MIN_RECIPROCAL_CONDITION * eigenvalues[-1] > 0.0)
