"""A small world of places, each with its own descriptors, seen by the real vocabulary and index."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import covinz_core
import numpy as np
import pytest

from covinz.config import FeatureKind, LoopSolverConfig, PlaceRecognitionConfig
from covinz.frames import transform
from covinz.types import (
    Camera,
    Features,
    FeatureType,
    Keyframe,
    KeyframeId,
    LogEntry,
    LoopJob,
    RigMember,
)
from services.place_recognition.places import Places
from services.place_recognition.recognizer import Recognizer

SESSIONS = {
    name: f"01ARZ3NDEKTSV4RRFFQ69G5F{i}{i}" for i, name in enumerate(("a", "b", "c", "a2", "d"))
}
# Looks ahead, along the body's x axis.
CAMERA = Camera(
    "PINHOLE",
    640,
    480,
    np.array([500.0, 500.0, 319.5, 239.5]),
    transform(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3)),
)
CAMERA_HASH = "0123456789abcdef"


@dataclass(frozen=True)
class World:
    """Makes keyframes and recognizers.

    Attributes:
        vocabulary: Trained on the places' descriptors.
        sift_vocabulary: The same of 128 bytes.
        places: (P, F, 32) descriptors of every place.
    """

    vocabulary: covinz_core.Vocabulary
    sift_vocabulary: covinz_core.ByteVocabulary
    places: np.ndarray

    def keyframe(
        self,
        name: str,
        seq: int,
        place: int,
        num_features: int = 60,
        kind: FeatureType = FeatureType.ORB,
        stamp_ns: int | None = None,
        also: FeatureType | None = None,
    ) -> Keyframe:
        """Keyframe `seq` of a session by its short name: one metre and one second a `seq`."""
        more = () if also is None else (self.features(also, place, num_features),)
        return Keyframe(
            id=kf_id(name, seq),
            stamp_ns=seq * 1_000_000_000 if stamp_ns is None else stamp_ns,
            T_odom_body=transform(np.eye(3), [float(seq), 0.0, 0.0]),
            camera_hash=CAMERA_HASH,
            features=self.features(kind, place, num_features),
            more_features=more,
        )

    def features(self, kind: FeatureType, place: int, num_features: int) -> Features:
        """What a place shows, by one kind of feature."""
        descriptors = self.places[place, :num_features]
        if kind is FeatureType.SIFT:
            descriptors = as_sift(descriptors)
        return Features(kind, np.zeros((num_features, 2), np.float32), descriptors)

    def recognizer(
        self,
        solver: LoopSolverConfig | None = None,
        cameras: Mapping[str, Camera] = MappingProxyType({CAMERA_HASH: CAMERA}),
        **options: object,
    ) -> Recognizer:
        """An empty recognizer over the real index; guards are off unless asked for."""
        values = {"min_loop_keyframes": 1, "min_loop_s": 0.0, "min_score": 1.0, **options}
        config = PlaceRecognitionConfig.model_validate(values)
        solver = solver or LoopSolverConfig()
        vocabularies: dict[FeatureKind, Any] = {
            "orb": self.vocabulary,
            "sift": self.sift_vocabulary,
        }
        places = Places(config, solver.kinds, vocabularies)
        return Recognizer(config, solver, places, cameras.get)


def as_sift(descriptors: np.ndarray) -> np.ndarray:
    """Descriptors (N, 128) that differ as those (N, 32) do."""
    return np.tile(descriptors, (1, 4))


def kf_id(name: str, seq: int) -> KeyframeId:
    return KeyframeId(name[0], SESSIONS[name], seq)


@pytest.fixture(scope="session")
def world() -> World:
    rng = np.random.default_rng(7)
    places = rng.integers(0, 256, (12, 60, 32), dtype=np.uint8)
    flat = places.reshape(-1, 32)
    offsets = np.arange(0, len(flat) + 1, 60, dtype=np.int64)
    vocabulary = covinz_core.Vocabulary.train(flat, offsets, branching=8, depth=4, seed=1)
    sift = covinz_core.ByteVocabulary.train(as_sift(flat), offsets, branching=8, depth=4, seed=1)
    return World(vocabulary, sift, places)


@pytest.fixture(scope="session")
def kid() -> Callable[[str, int], KeyframeId]:
    return kf_id


Describe = Callable[[Iterable[LoopJob]], list[object]]


def _bytes(member: RigMember) -> bytes | None:
    covariance = member.motion_covariance
    return None if covariance is None else covariance.tobytes()


@pytest.fixture(scope="session")
def describe() -> Describe:
    """Everything that a job says, comparable."""

    def describe(jobs: Iterable[LoopJob]) -> list[object]:
        return [
            (
                job.id,
                job.score,
                *[
                    (m.keyframe, m.T_odom_body.tobytes(), m.camera_hash, _bytes(m))
                    for m in (*job.query_rig, *job.cand_rig)
                ],
                len(job.query_rig),
            )
            for job in jobs
        ]

    return describe


@pytest.fixture(scope="session")
def log_of() -> Callable[[Iterable[Keyframe]], list[LogEntry]]:
    def log_of(keyframes: Iterable[Keyframe]) -> list[LogEntry]:
        return [LogEntry(i, kf) for i, kf in enumerate(keyframes)]

    return log_of
