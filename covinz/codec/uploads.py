"""What an agent uploads and is answered: Camera, Keyframe, Gap, UploadReply."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from covinz.codec import poses, values
from covinz.codec.reader import Fields
from covinz.types import (
    NUM_CAMERA_PARAMS,
    Camera,
    Duplicate,
    Features,
    FeatureType,
    Gap,
    Keyframe,
    NeedCamera,
    Rejected,
    RetryAfter,
    Stored,
    UploadReply,
)

MAX_IMAGE_PX: Final = 4096
MAX_PARAM: Final = 1e9
MAX_READOUT_S: Final = 1.0
KEYPOINT_UNITS_PER_PX: Final = 16
_WIRE_TYPE: Final = {FeatureType.ORB: "Orb", FeatureType.SIFT: "Sift"}
_TYPE_OF_WIRE: Final = {name: kind for kind, name in _WIRE_TYPE.items()}


def camera_fields(camera: Camera) -> Fields:
    """Fields of a Camera."""
    poses.check_rigid(camera.T_body_cam, "T_body_cam")
    return {
        "model": values.text(camera.model, "model"),
        "width": values.whole(camera.width, "width", 1, MAX_IMAGE_PX),
        "height": values.whole(camera.height, "height", 1, MAX_IMAGE_PX),
        "params": _params(camera.model, camera.params),
        "matrix_body_cam": camera.T_body_cam[:3].ravel(),
        "readout_s": _readout(camera.readout_s),
    }


def camera(fields: Fields) -> Camera:
    """The inverse of `camera_fields`."""
    T_body_cam = np.eye(4)
    T_body_cam[:3] = values.numbers(fields["matrix_body_cam"], "T_body_cam", 12).reshape(3, 4)
    poses.check_rigid(T_body_cam, "T_body_cam")
    return Camera(
        model=fields["model"],
        width=values.whole(fields["width"], "width", 1, MAX_IMAGE_PX),
        height=values.whole(fields["height"], "height", 1, MAX_IMAGE_PX),
        params=_params(fields["model"], fields["params"]),
        T_body_cam=T_body_cam,
        readout_s=_readout(fields["readout_s"]),
    )


def _readout(readout_s: float | None) -> float | None:
    if readout_s is None:
        return None
    if values.finite(readout_s, "readout_s", low=0.0) > MAX_READOUT_S:
        raise ValueError(f"readout_s: {readout_s} is not a time [s] up to {MAX_READOUT_S}")
    return float(readout_s)


def _params(model: str, params: NDArray[Any]) -> NDArray[Any]:
    if model not in NUM_CAMERA_PARAMS:
        raise ValueError(f"model: {model!r} is none of {', '.join(NUM_CAMERA_PARAMS)}")
    array = values.numbers(params, "params", NUM_CAMERA_PARAMS[model], MAX_PARAM)
    if not (array[0] > 0 and array[1] > 0):
        raise ValueError("params: a focal length is not above 0")
    return array


def keyframe_fields(kf: Keyframe) -> Fields:
    """Fields of a Keyframe."""
    return {
        "id": values.keyframe_id_fields(kf.id),
        "stamp_ns": values.whole(kf.stamp_ns, "stamp_ns"),
        "pose_odom_body": tuple(poses.pose_values(kf.T_odom_body, "T_odom_body")),
        "camera_hash": values.text(kf.camera_hash, "camera_hash", values.CAMERA_HASH),
        "features": None if kf.features is None else _features_fields(kf.features),
        "covariance": _odometry_covariance(kf.covariance),
        "gravity_body": _gravity(kf.gravity_body),
        "thumbnail_jpeg": kf.thumbnail_jpeg,
        "more_features": [_features_fields(block) for block in kf.more_features] or None,
    }


def keyframe(fields: Fields) -> Keyframe:
    """The inverse of `keyframe_fields`."""
    covariance = _odometry_covariance(fields["covariance"])
    thumbnail = fields["thumbnail_jpeg"]
    return Keyframe(
        id=values.keyframe_id(fields["id"]),
        stamp_ns=values.whole(fields["stamp_ns"], "stamp_ns"),
        T_odom_body=poses.transforms(fields["pose_odom_body"], "T_odom_body"),
        camera_hash=values.text(fields["camera_hash"], "camera_hash", values.CAMERA_HASH),
        features=None if fields["features"] is None else _features(fields["features"]),
        covariance=None if covariance is None else covariance.reshape(6, 6),
        gravity_body=_gravity(fields["gravity_body"]),
        thumbnail_jpeg=None if thumbnail is None else thumbnail.tobytes(),
        more_features=tuple(_features(block) for block in fields["more_features"] or ()),
    )


def _odometry_covariance(covariance: NDArray[Any] | None) -> NDArray[Any] | None:
    if covariance is None:
        return None
    return values.covariance(covariance, "covariance", definite=False)


def _gravity(direction: NDArray[Any] | None) -> NDArray[Any] | None:
    if direction is None:
        return None
    array = values.numbers(direction, "gravity_body", 3, bound=2.0)
    if abs(float(np.linalg.norm(array)) - 1) > poses.UNIT_TOLERANCE:
        raise ValueError("gravity_body: not of length 1")
    return array


def _features_fields(features: Features) -> Fields:
    fixed = np.rint(features.keypoints_px.astype(np.float64) * KEYPOINT_UNITS_PER_PX)
    # NaN fails both comparisons.
    if not np.all((fixed >= 0) & (fixed <= np.iinfo(np.uint16).max)):
        raise ValueError("keypoints_px: a keypoint is not within [0, 4095.9375] px")
    return {
        "type": _WIRE_TYPE[features.type],
        "coding": "Raw",
        "keypoints": fixed.astype(np.uint16),
        "descriptors": features.descriptors,
    }


def _features(fields: Fields) -> Features:
    if fields["type"] is None:
        raise ValueError("features.type is missing")
    kind = _TYPE_OF_WIRE[fields["type"]]
    keypoints, descriptors = fields["keypoints"], fields["descriptors"]
    n = len(keypoints) // 2
    if len(keypoints) != 2 * n or len(descriptors) != n * kind.descriptor_bytes:
        raise ValueError(
            f"features: {len(keypoints)} coordinates and {len(descriptors)} bytes of "
            f"descriptors do not make {kind.name} features"
        )
    pixels = keypoints.reshape(n, 2).astype(np.float32) / np.float32(KEYPOINT_UNITS_PER_PX)
    return Features(kind, pixels, descriptors.reshape(n, kind.descriptor_bytes))


def gap_fields(gap: Gap) -> Fields:
    """Fields of a Gap."""
    first = values.whole(gap.first_seq, "first_seq")
    return {
        "agent": values.agent_id(gap.agent),
        "session": values.ulid(gap.session, "session"),
        "first_seq": first,
        "last_seq": values.whole(gap.last_seq, "last_seq", low=first),
        "reason": values.text(gap.reason, "reason"),
    }


def gap(fields: Fields) -> Gap:
    """The inverse of `gap_fields`."""
    return Gap(**gap_fields(Gap(**fields)))


def upload_reply_fields(reply: UploadReply) -> Fields:
    """Fields of an UploadReply."""
    answer: Fields = {}
    if isinstance(reply, RetryAfter):
        seconds = values.finite(reply.seconds, "seconds", low=0.0)
        answer = {"seconds": seconds, "reason": values.text(reply.reason, "reason")}
    elif isinstance(reply, NeedCamera):
        answer["camera_hash"] = values.text(reply.camera_hash, "camera_hash", values.CAMERA_HASH)
    elif isinstance(reply, Rejected):
        code = values.text(reply.code, "code", values.CODE)
        answer = {"code": code, "reason": values.text(reply.reason, "reason")}
    return {"answer": (type(reply).__name__, answer)}


def upload_reply(fields: Fields) -> UploadReply:
    """The inverse of `upload_reply_fields`."""
    name, answer = fields["answer"]
    kinds = {kind.__name__: kind for kind in (Stored, Duplicate, RetryAfter, NeedCamera, Rejected)}
    reply: UploadReply = kinds[name](**answer)
    upload_reply_fields(reply)
    return reply
