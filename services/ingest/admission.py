"""Admission: which uploads may enter the keyframe log. Pure functions, no I/O.

Whatever an agent sends costs one decode and ends in one typed answer. The codec has checked that
every number is finite, every pose rigid and every length right; what is checked here needs the
sender, the configuration or the registered cameras.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from covinz import codec
from covinz.config import IngestConfig
from covinz.types import Camera, Features, Gap, Keyframe, NeedCamera, Rejected


class Code(enum.StrEnum):
    """Why an upload can never be accepted: every code of `Rejected`."""

    BAD_KEY = "bad_key"  # not asked on covinz/agent/{agent}/up/{keyframe,camera}
    TOO_LARGE = "too_large"  # more bytes than `ingest.max_upload_bytes`
    MALFORMED = "malformed"  # not our message, or a length, number or name in it is impossible
    FOREIGN_AGENT = "foreign_agent"  # the message names another agent than its key
    BAD_SEQ = "bad_seq"  # a sequence number above MAX_SEQ
    NO_FEATURES = "no_features"  # without the block of features; an empty block is fine
    TOO_MANY_FEATURES = "too_many_features"  # more than `ingest.max_features` in all
    KEYPOINT_OUTSIDE = "keypoint_outside"  # a keypoint outside the image of its camera
    TOO_MANY_CAMERAS = "too_many_cameras"  # more than `ingest.max_cameras_per_agent`
    LONG_REASON = "long_reason"  # a gap whose reason has more than MAX_REASON characters
    CONFLICT = "conflict"  # the log holds something else under this id


# At ten keyframes a second a session reaches this after six years.
MAX_SEQ = 2**31 - 1
# Characters of a text that goes into the log or back to the agent.
MAX_REASON = 200


@dataclass(frozen=True, slots=True, eq=False)
class AdmittedUpload:
    """A keyframe or gap that may enter the log.

    Attributes:
        item: What was sent.
        payload: Its message as it came.
        pose: Its message in the ``pose`` view: without features.
    """

    item: Keyframe | Gap
    payload: bytes
    pose: bytes


@dataclass(frozen=True, slots=True, eq=False)
class AdmittedCamera:
    """A calibration that may be registered, and by whom."""

    agent: str
    camera: Camera
    payload: bytes


def admit_upload(
    agent: str, payload: bytes, cameras: Mapping[str, Camera], config: IngestConfig
) -> AdmittedUpload | NeedCamera | Rejected:
    """Check a keyframe or gap.

    Args:
        agent: Who sent it, from the key.
        payload: The message.
        cameras: Registered calibrations by hash.
        config: Limits.
    """
    try:
        item = codec.decode_upload(payload)
    except codec.MalformedMessage as error:
        return rejected(Code.MALFORMED, str(error))
    if isinstance(item, Gap):
        return _check_gap(agent, item) or AdmittedUpload(item, payload, payload)
    refusal = _check_name(agent, item.id.agent, item.id.seq) or _check_features(
        item, cameras, config
    )
    return refusal or AdmittedUpload(item, payload, codec.encode(codec.without_features(item)))


def admit_camera(agent: str, payload: bytes) -> AdmittedCamera | Rejected:
    """Check a calibration that `agent` wants to register."""
    try:
        camera = codec.decode(payload, Camera)
    except codec.MalformedMessage as error:
        return rejected(Code.MALFORMED, str(error))
    return AdmittedCamera(agent, camera, payload)


def rejected(code: Code, reason: str) -> Rejected:
    """The answer; long reasons are cut, for they may quote what was sent."""
    return Rejected(code.value, reason[:MAX_REASON])


def _check_name(agent: str, claimed: str, last_seq: int) -> Rejected | None:
    if claimed != agent:
        return rejected(Code.FOREIGN_AGENT, f"{agent} must not write for {claimed}")
    if last_seq > MAX_SEQ:
        return rejected(Code.BAD_SEQ, f"sequence number {last_seq} is above {MAX_SEQ}")
    return None


def _check_gap(agent: str, gap: Gap) -> Rejected | None:
    if len(gap.reason) > MAX_REASON:
        return rejected(Code.LONG_REASON, f"a reason has at most {MAX_REASON} characters")
    return _check_name(agent, gap.agent, gap.last_seq)


def _check_features(
    kf: Keyframe, cameras: Mapping[str, Camera], config: IngestConfig
) -> NeedCamera | Rejected | None:
    if kf.features is None:
        return rejected(Code.NO_FEATURES, "a keyframe is uploaded with its features")
    count = sum(len(block) for block in kf.all_features)
    if count > config.max_features:
        return rejected(
            Code.TOO_MANY_FEATURES, f"{count} features of at most {config.max_features}"
        )
    camera = cameras.get(kf.camera_hash)
    if camera is None:
        return NeedCamera(kf.camera_hash)
    if not all(_inside(block, camera) for block in kf.all_features):
        size = f"{camera.width} x {camera.height} pixels"
        return rejected(Code.KEYPOINT_OUTSIDE, f"a keypoint is outside of {size}")
    return None


def _inside(features: Features, camera: Camera) -> bool:
    # Pixel centres are whole numbers: the image begins half a pixel before 0.
    size = np.array([camera.width, camera.height])
    px = features.keypoints_px
    return bool(np.all((px >= -0.5) & (px <= size - 0.5)))
