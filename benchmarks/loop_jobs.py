"""Loop jobs of chosen pairs of keyframes, made by place recognition itself.

In place of its indices it is given one that knows which pairs are wanted; rigs, motions, waiting
for later keyframes and seeds are then as in a run where it had found those pairs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set

import numpy as np
from numpy.typing import NDArray

from benchmarks.fleet import Fleet
from covinz import frames
from covinz.config import PlaceRecognitionConfig
from covinz.types import Keyframe, KeyframeId, LogEntry, LoopJob
from services.place_recognition.places import Description, Descriptions, Places
from services.place_recognition.recognizer import Recognizer

_NEAR_M = 0.7
_NEAR_RAD = np.deg2rad(40)
_APART_NS = 2_000_000_000
_ELSEWHERE_M = 1.5
_ELSEWHERE_RAD = np.deg2rad(60)

Pair = frozenset[KeyframeId]


class ChosenPairs(Places):
    """Finds exactly the pairs that are wanted, each with score 1."""

    def __init__(self, wanted: Set[Pair]) -> None:
        super().__init__(PlaceRecognitionConfig(), (), {})
        self._wanted = wanted
        self._indexed: list[KeyframeId] = []
        # Asked for right before a keyframe is looked up and added.
        self._now: KeyframeId | None = None

    def __len__(self) -> int:
        return len(self._indexed)

    def describe(self, kf: Keyframe) -> Descriptions:
        """Nothing but that the keyframe takes part."""
        self._now = kf.id
        nothing = Description(np.zeros(0, np.uint32), np.zeros((0, 32), np.uint8))
        return {"orb": nothing}

    def best(self, query: Descriptions, mask: NDArray[np.bool_]) -> list[tuple[int, float]]:
        """Slots of what makes a wanted pair with the keyframe at hand."""
        return [
            (slot, 1.0)
            for slot, other in enumerate(self._indexed)
            if mask[slot] and frozenset((self._now, other)) in self._wanted
        ]

    def add(self, descriptions: Descriptions) -> int:
        """Put the keyframe at hand in and return its slot."""
        assert self._now is not None
        self._indexed.append(self._now)
        return len(self._indexed) - 1


def jobs_of(fleet: Fleet, pairs: Set[Pair], profile: str) -> list[LoopJob]:
    """The jobs of these pairs of different robots; of a pair the later keyframe is the query."""
    config = fleet.config(profile)
    rigs = config.place_recognition.rigs
    settings = PlaceRecognitionConfig(other_agents_only=True, rigs=rigs)
    recognizer = Recognizer(settings, config.loop_solver, ChosenPairs(pairs), fleet.cameras.get)
    log = (LogEntry(index, kf) for index, kf in enumerate(fleet.keyframes.values()))
    return [job for entry in log for job in recognizer.process(entry)]


def near_pairs(fleet: Fleet) -> set[Pair]:
    """Pairs of different robots that see one place by ground truth.

    Nearer than 0.7 m and 40 degrees, and more than 2 s apart, so that no image is in both.
    """
    return {
        frozenset((a, b))
        for a, b, moved_m, turned_rad in _pairs(fleet)
        if moved_m < _NEAR_M
        and turned_rad < _NEAR_RAD
        and abs(fleet.keyframe(a).stamp_ns - fleet.keyframe(b).stamp_ns) > _APART_NS
    }


def far_pairs(fleet: Fleet) -> set[Pair]:
    """Pairs of different robots that see different parts of a room, or little in common.

    Further apart than 1.5 m by ground truth, or turned by more than 60 degrees.
    """
    return {
        frozenset((a, b))
        for a, b, moved_m, turned_rad in _pairs(fleet)
        if moved_m > _ELSEWHERE_M or turned_rad > _ELSEWHERE_RAD
    }


def random_pairs(
    first: Iterable[KeyframeId], second: Iterable[KeyframeId], count: int
) -> set[Pair]:
    """As many pairs of one of the first with one of the second, drawn with a fixed seed."""
    found = [frozenset((a, b)) for a in first for b in second]
    drawn = np.random.default_rng(0).permutation(len(found))[:count]
    return {found[i] for i in drawn}


def _pairs(fleet: Fleet) -> Iterator[tuple[KeyframeId, KeyframeId, float, float]]:
    """All pairs of different robots with ground truth; their true distance and angle."""
    posed = [name for name in fleet.keyframes if name in fleet.T_world_body]
    for number, a in enumerate(posed):
        for b in posed[:number]:
            if a.agent != b.agent:
                T = frames.inverse(fleet.T_world_body[b]) @ fleet.T_world_body[a]
                yield a, b, float(np.linalg.norm(T[:3, 3])), float(frames.rotation_angle(T))
