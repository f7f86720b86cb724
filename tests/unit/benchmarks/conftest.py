"""Two robots for the benchmarks of loops, whose images have nothing in common."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from benchmarks.fleet import Fleet
from covinz.frames import so3_exp, transform
from covinz.types import Camera, Features, FeatureType, Keyframe, KeyframeId

SESSIONS = {"a": "01ARZ3NDEKTSV4RRFFQ69G5FAV", "b": "01ARZ3NDEKTSV4RRFFQ69G5FAW"}
CAMERA = Camera("PINHOLE", 640, 480, np.array([500.0, 500.0, 320.0, 240.0]), np.eye(4))
SECOND = 1_000_000_000
COUNT = 6


def name(agent: str, seq: int) -> KeyframeId:
    return KeyframeId(agent, SESSIONS[agent], seq)


@pytest.fixture
def fleet() -> Fleet:
    """Two robots go the same way, 0.5 m a keyframe; the second ten seconds later, turned aside."""
    rng = np.random.default_rng(0)
    keyframes, poses = {}, {}
    for (agent, start_s, yaw), seq in product((("a", 0, 0.0), ("b", 10, 0.3)), range(COUNT)):
        T = transform(so3_exp([0, yaw, 0]), [0.5 * seq, 0, 0])
        features = Features(
            FeatureType.ORB,
            rng.uniform(0, 480, (40, 2)).astype(np.float32),
            rng.integers(0, 256, (40, 32), dtype=np.uint8),
        )
        stamp_ns = (start_s + seq) * SECOND
        keyframes[name(agent, seq)] = Keyframe(name(agent, seq), stamp_ns, T, CAMERA.hash, features)
        poses[name(agent, seq)] = T
    return Fleet({}, keyframes, {CAMERA.hash: CAMERA}, poses, {})
