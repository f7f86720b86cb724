"""Loop jobs of chosen pairs of keyframes, formed as place recognition forms its own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.fleet import Fleet
from covinz import frames
from covinz.types import KeyframeId, LoopJob, SegmentId
from services.place_recognition import rigs
from services.place_recognition.rigs import JobMint, Pair
from services.place_recognition.track import Track

_NEAR_M = 0.7
_NEAR_RAD = np.deg2rad(40)
_APART_NS = 2_000_000_000
_ELSEWHERE_M = 3.0
_ELSEWHERE_RAD = np.deg2rad(120)

Pairs = list[tuple[KeyframeId, KeyframeId]]


class JobForm:
    """Forms jobs of a fleet under a profile; every keyframe counts as logged."""

    def __init__(self, fleet: Fleet, profile: str) -> None:
        # No vocabulary had a part in the choice of the pairs.
        self._mint = JobMint(fleet.config(profile).loop_solver, vocabulary_hash="")
        self._tracks: dict[SegmentId, Track] = {}
        for keyframe in fleet.keyframes.values():
            segment = keyframe.id.segment
            self._tracks.setdefault(segment, Track(segment)).insert(keyframe)

    def job(self, query: KeyframeId, cand: KeyframeId) -> LoopJob | None:
        """The job of a pair; None where its session is too short for a rig, or the rigs overlap."""
        query_rig = rigs.query_rig(self._tracks[query.segment], query.seq)
        cand_rig = rigs.cand_rig(self._tracks[cand.segment], cand.seq)
        if query_rig is None or cand_rig is None or rigs.overlap(query_rig, cand_rig):
            return None
        return self._mint.job(Pair(query, cand, 0.0), query_rig, cand_rig)


def near_pairs(fleet: Fleet) -> Pairs:
    """Query and earlier candidate of different robots that see one place by ground truth.

    Nearer than 0.7 m and 40 degrees, and more than 2 s apart, so that no image is in both.
    """
    return [
        (query, cand)
        for query, cand, moved_m, turned_rad in _pairs(fleet)
        if moved_m < _NEAR_M
        and turned_rad < _NEAR_RAD
        and abs(fleet.keyframe(query).stamp_ns - fleet.keyframe(cand).stamp_ns) > _APART_NS
    ]


def far_pairs(fleet: Fleet, count: int) -> Pairs:
    """As many pairs of different robots, drawn with a fixed seed, that see different places.

    Further apart than 3 m by ground truth, or turned by more than 120 degrees.
    """
    found = [
        (query, cand)
        for query, cand, moved_m, turned_rad in _pairs(fleet)
        if moved_m > _ELSEWHERE_M or turned_rad > _ELSEWHERE_RAD
    ]
    drawn = np.random.default_rng(0).permutation(len(found))[:count]
    return [found[i] for i in sorted(drawn)]


def _pairs(fleet: Fleet) -> Iterator[tuple[KeyframeId, KeyframeId, float, float]]:
    """All pairs of different robots, the query of the later name; true distance and angle."""
    posed = [name for name in fleet.keyframes if name in fleet.T_world_body]
    for query in posed:
        for cand in posed:
            if cand.agent < query.agent:
                T = frames.inverse(fleet.T_world_body[cand]) @ fleet.T_world_body[query]
                yield query, cand, float(np.linalg.norm(T[:3, 3])), float(frames.rotation_angle(T))
