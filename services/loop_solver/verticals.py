"""Which way is down at both ends of a loop, where both robots know it."""

from __future__ import annotations

import covinz_core
import numpy as np

from covinz.keyframes import KeyframeStore
from covinz.types import Array, KeyframeId, LoopJob


def verticals(job: LoopJob, store: KeyframeStore) -> covinz_core.Verticals | None:
    """Gravity's direction in the bodies of query and candidate; None where one does not know it.

    It only proposes poses and takes no part in their estimation, so a wrong one does no harm.

    Raises:
        KeyframeNotFound, StoreUnavailable: From the store.

    Source: decision 0019.
    """
    query, cand = _down(store, job.query), _down(store, job.cand)
    return None if query is None or cand is None else covinz_core.Verticals(query, cand)


def _down(store: KeyframeStore, keyframe: KeyframeId) -> Array | None:
    """A unit vector to more digits than a robot may have sent."""
    gravity = store.keyframe(keyframe).gravity_body
    if gravity is None:
        return None
    length = float(np.linalg.norm(gravity))
    return gravity / length if 0.5 < length < 2.0 else None
