"""Keyframes, cameras and their messages for tests of the way from robot to log."""

from __future__ import annotations

import numpy as np

from covinz import codec, frames
from covinz.types import (
    Camera,
    Features,
    FeatureType,
    Keyframe,
    KeyframeContent,
    KeyframeId,
)

SESSION = "01JD0000000000000000000000"
OTHER_SESSION = "01JD0000000000000000000001"
CAMERA = Camera("PINHOLE", 640, 480, np.array([500.0, 500.0, 319.5, 239.5]), np.eye(4))


def features(num: int = 3, seed: int = 0) -> Features:
    """ORB features at random places of the image of CAMERA, on the grid of the wire."""
    rng = np.random.default_rng(seed)
    px = rng.integers(0, [640 * 16 - 16, 480 * 16 - 16], size=(num, 2)) / 16
    descriptors = rng.integers(0, 256, size=(num, 32), dtype=np.uint8)
    return Features(FeatureType.ORB, px.astype(np.float32), descriptors)


def content(seed: int = 0, camera: Camera = CAMERA, num_features: int = 3) -> KeyframeContent:
    """What a front-end hands to an agent; another seed is another pose."""
    T_odom_body = frames.transform(frames.so3_exp([0.0, 0.0, 0.1 * seed]), [seed, 0.0, 0.0])
    return KeyframeContent(10**18 + seed, T_odom_body, camera, features(num_features, seed))


def keyframe(
    seq: int = 0, agent: str = "a0", session: str = SESSION, num_features: int = 3
) -> Keyframe:
    """The keyframe that `content(seq)` becomes."""
    made = content(seq, num_features=num_features)
    return Keyframe(
        KeyframeId(agent, session, seq),
        made.stamp_ns,
        made.T_odom_body,
        made.camera.hash,
        made.features,
    )


def message(seq: int = 0, agent: str = "a0", num_features: int = 3) -> bytes:
    """The message of `keyframe(seq)`."""
    return codec.encode(keyframe(seq, agent, num_features=num_features))
