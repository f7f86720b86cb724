"""What a robot sends: calibrations, keyframes, gaps."""

from __future__ import annotations

import enum
import hashlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from covinz.types.identity import Array, KeyframeId, frozen_array

# COLMAP's camera models that covinz knows, and how many parameters each has.
NUM_CAMERA_PARAMS: Final = {"PINHOLE": 4, "OPENCV": 8, "FULL_OPENCV": 12, "OPENCV_FISHEYE": 8}


class FeatureType(enum.Enum):
    """Kind of local feature; the value is the length of one descriptor in bytes."""

    ORB = 32
    SIFT = 128

    @property
    def descriptor_bytes(self) -> int:
        """Length of one descriptor."""
        return int(self.value)


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A calibrated camera on a robot.

    Attributes:
        model: COLMAP name: PINHOLE, OPENCV, FULL_OPENCV or OPENCV_FISHEYE.
        width: Image width in pixels.
        height: Image height in pixels.
        params: Intrinsics in COLMAP's order for the model.
        T_body_cam: (4, 4) pose of the camera (x right, y down, z forward) in the body frame.
        readout_s: Seconds from the exposure of an image's first row to that of its last, in which
            its stamp lies; 0 where all rows are exposed at the stamp. None when unknown.
    """

    model: str
    width: int
    height: int
    params: Array
    T_body_cam: Array
    readout_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "params", frozen_array(self.params, (None,)))
        # -0.0 becomes 0.0: it would be another hash, and in the last row it does not travel.
        T_body_cam = np.asarray(self.T_body_cam, dtype=np.float64) + 0.0
        object.__setattr__(self, "T_body_cam", frozen_array(T_body_cam, (4, 4)))

    @property
    def hash(self) -> str:
        """Content hash (16 hex digits) under which the calibration is registered once."""
        digest = hashlib.blake2b(digest_size=8)
        digest.update(f"{self.model} {self.width} {self.height}\n".encode())
        digest.update(self.params.astype("<f8").tobytes())
        digest.update(self.T_body_cam.astype("<f8").tobytes())
        if self.readout_s is not None:
            digest.update(np.array(self.readout_s + 0.0, "<f8").tobytes())
        return digest.hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """The local features of one image.

    Attributes:
        type: Kind of feature.
        keypoints_px: (N, 2) float32 raw (distorted) pixel positions x, y.
        descriptors: (N, type.descriptor_bytes) uint8.
    """

    type: FeatureType
    keypoints_px: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def __post_init__(self) -> None:
        n = len(self.keypoints_px)
        object.__setattr__(self, "keypoints_px", frozen_array(self.keypoints_px, (n, 2), "f4"))
        shape = (n, self.type.descriptor_bytes)
        object.__setattr__(self, "descriptors", frozen_array(self.descriptors, shape, "u1"))

    def __len__(self) -> int:
        return len(self.keypoints_px)


def feature_blocks(
    features: Features | None, more_features: tuple[Features, ...]
) -> tuple[Features, ...]:
    """All features of a keyframe, one block for each kind.

    Raises:
        ValueError: If a kind is there twice, or further kinds without a first one.
    """
    if features is None:
        if more_features:
            raise ValueError("more_features without features")
        return ()
    blocks = (features, *more_features)
    if len({block.type for block in blocks}) != len(blocks):
        raise ValueError("more_features: a kind of feature is there twice")
    return blocks


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeContent:
    """What a front-end measures for one keyframe, before the agent gives it an id.

    Attributes:
        stamp_ns: Time of exposure.
        T_odom_body: (4, 4) odometry pose; never changed afterwards.
        camera: Calibration of the image.
        features: Local features of the image.
        covariance: Optional (6, 6) covariance of the motion since the previous keyframe: right
            perturbation [rotation (rad), translation (m)] of ``T_prev_cur``, in the current body
            frame.
        gravity_body: Optional (3,) unit direction of gravity in the body frame.
        thumbnail_jpeg: Optional small picture for viewers.
        more_features: Features of further kinds of the same image; no kind twice.
    """

    stamp_ns: int
    T_odom_body: Array
    camera: Camera
    features: Features
    covariance: Array | None = None
    gravity_body: Array | None = None
    thumbnail_jpeg: bytes | None = None
    more_features: tuple[Features, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "more_features", tuple(self.more_features))
        feature_blocks(self.features, self.more_features)


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A keyframe as it is logged; fields as in `KeyframeContent`.

    `features` is None in the log's ``pose`` view, which leaves all features out.
    """

    id: KeyframeId
    stamp_ns: int
    T_odom_body: Array
    camera_hash: str
    features: Features | None
    covariance: Array | None = None
    gravity_body: Array | None = None
    thumbnail_jpeg: bytes | None = None
    more_features: tuple[Features, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "more_features", tuple(self.more_features))
        feature_blocks(self.features, self.more_features)
        object.__setattr__(self, "T_odom_body", frozen_array(self.T_odom_body, (4, 4)))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", frozen_array(self.covariance, (6, 6)))
        if self.gravity_body is not None:
            object.__setattr__(self, "gravity_body", frozen_array(self.gravity_body, (3,)))

    @property
    def all_features(self) -> tuple[Features, ...]:
        """Its features, one block for each kind."""
        return feature_blocks(self.features, self.more_features)

    def features_of(self, kind: FeatureType) -> Features | None:
        """Its features of one kind."""
        return next((block for block in self.all_features if block.type is kind), None)


@dataclass(frozen=True, slots=True)
class Gap:
    """A range of a session's keyframes that its agent had to drop; durable like a keyframe."""

    agent: str
    session: str
    first_seq: int
    last_seq: int
    reason: str
