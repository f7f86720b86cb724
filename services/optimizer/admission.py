"""Which loops the optimizer takes: well formed, near, with a covariance that has an inverse."""

from __future__ import annotations

import enum

import numpy as np

from covinz import codec
from covinz.types import LoopClosure, Rejected

# Loops are metres long; beyond this numbers overflow before they mean anything. [m]
MAX_TRANSLATION_M = 1e4
# No loop is known better than to a micrometre and a microradian. [m^2, rad^2]
MIN_VARIANCE = 1e-12
# Smallest over largest eigenvalue of a covariance whose inverse is still accurate to six digits.
MIN_RECIPROCAL_CONDITION = 1e-10


class Code(enum.Enum):
    """Checks that a loop can fail."""

    MALFORMED = "malformed"
    SELF_LOOP = "self_loop"
    BAD_POSE = "bad_pose"
    BAD_COVARIANCE = "bad_covariance"


def admit(payload: bytes) -> LoopClosure | Rejected:
    """Read a loop closure as a worker sent it, or say what is wrong with it.

    Decoding has checked that the pose is rigid and the covariance positive definite.
    """
    try:
        loop = codec.decode(payload, LoopClosure)
    except codec.MalformedMessage as error:
        return Rejected(Code.MALFORMED.value, str(error))
    if loop.query == loop.cand:
        return Rejected(Code.SELF_LOOP.value, f"{loop.query} is query and candidate")
    if np.linalg.norm(loop.T_cand_query[:3, 3]) > MAX_TRANSLATION_M:
        return Rejected(Code.BAD_POSE.value, f"farther than {MAX_TRANSLATION_M:g} m")
    eigenvalues = np.linalg.eigvalsh(loop.covariance)
    if not eigenvalues[0] >= max(MIN_VARIANCE, MIN_RECIPROCAL_CONDITION * eigenvalues[-1]):
        reason = f"covariance has eigenvalues {eigenvalues[0]:g} to {eigenvalues[-1]:g}"
        return Rejected(Code.BAD_COVARIANCE.value, reason)
    return loop
