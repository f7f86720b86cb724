"""What may enter the log: every answer, for every kind of bad upload."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz import codec
from covinz.codec.reader import read
from covinz.codec.writer import write
from covinz.config import IngestConfig
from covinz.types import (
    Camera,
    Features,
    FeatureType,
    Gap,
    Keyframe,
    KeyframeId,
    NeedCamera,
    Rejected,
)
from services.ingest.admission import (
    MAX_SEQ,
    AdmittedCamera,
    AdmittedUpload,
    Code,
    admit_camera,
    admit_upload,
    rejected,
)
from tests.uploads import CAMERA, SESSION, features, keyframe, message

CONFIG = IngestConfig()
KNOWN = {CAMERA.hash: CAMERA}


def code_of(payload: bytes, agent: str = "a0", config: IngestConfig = CONFIG) -> str:
    answer = admit_upload(agent, payload, KNOWN, config)
    assert isinstance(answer, Rejected), answer
    assert answer.reason
    return answer.code


def test_a_good_keyframe_is_admitted_with_its_bytes_and_its_pose_view() -> None:
    payload = message(7)
    answer = admit_upload("a0", payload, KNOWN, CONFIG)
    assert isinstance(answer, AdmittedUpload)
    assert answer.payload == payload
    pose = codec.decode(answer.pose, Keyframe)
    assert pose.features is None
    assert pose.id == keyframe(7).id
    np.testing.assert_allclose(pose.T_odom_body, keyframe(7).T_odom_body, atol=1e-12)
    assert len(answer.pose) < len(payload)


def test_a_keyframe_without_a_single_feature_is_admitted() -> None:
    assert isinstance(admit_upload("a0", message(num_features=0), KNOWN, CONFIG), AdmittedUpload)


def test_a_gap_is_admitted() -> None:
    gap = Gap("a0", SESSION, 3, 9, "spool full")
    answer = admit_upload("a0", codec.encode(gap), {}, CONFIG)
    assert isinstance(answer, AdmittedUpload)
    assert answer.item == gap
    assert answer.pose == answer.payload


def test_an_unregistered_camera_is_asked_for() -> None:
    assert admit_upload("a0", message(), {}, CONFIG) == NeedCamera(CAMERA.hash)


def test_nobody_writes_for_another_agent() -> None:
    assert code_of(message(agent="a1"), agent="a0") == Code.FOREIGN_AGENT
    gap = codec.encode(Gap("a1", SESSION, 0, 1, "spool full"))
    assert code_of(gap, agent="a0") == Code.FOREIGN_AGENT


def test_numbers_out_of_range() -> None:
    far = dataclasses.replace(keyframe(), id=KeyframeId("a0", SESSION, MAX_SEQ + 1))
    assert code_of(codec.encode(far)) == Code.BAD_SEQ
    assert code_of(codec.encode(Gap("a0", SESSION, 0, MAX_SEQ + 1, "x"))) == Code.BAD_SEQ
    assert code_of(codec.encode(Gap("a0", SESSION, 0, 1, "x" * 201))) == Code.LONG_REASON


def test_features_missing_or_too_many() -> None:
    bare = codec.encode(codec.without_features(keyframe()))
    assert code_of(bare) == Code.NO_FEATURES
    assert code_of(message(num_features=9), config=IngestConfig(max_features=8)) == (
        Code.TOO_MANY_FEATURES
    )


@pytest.mark.parametrize(
    ("px", "inside"),
    [
        ((0.0, 0.0), True),
        ((639.5, 479.5), True),
        ((639.5625, 0.0), False),
        ((0.0, 479.5625), False),
    ],
)
def test_keypoints_lie_in_the_image(px: tuple[float, float], inside: bool) -> None:
    corner = Features(FeatureType.ORB, np.array([px], np.float32), np.zeros((1, 32), np.uint8))
    payload = codec.encode(dataclasses.replace(keyframe(), features=corner))
    answer = admit_upload("a0", payload, KNOWN, CONFIG)
    if inside:
        assert isinstance(answer, AdmittedUpload)
    else:
        assert isinstance(answer, Rejected)
        assert answer.code == Code.KEYPOINT_OUTSIDE


def sift_features(num: int) -> Features:
    return Features(FeatureType.SIFT, features(num).keypoints_px, np.zeros((num, 128), np.uint8))


def test_two_kinds_are_admitted_and_counted_together() -> None:
    kf = dataclasses.replace(keyframe(num_features=5), more_features=(sift_features(4),))
    answer = admit_upload("a0", codec.encode(kf), KNOWN, CONFIG)
    assert isinstance(answer, AdmittedUpload)
    assert codec.decode(answer.pose, Keyframe).all_features == ()
    assert len(answer.pose) < 400
    code = code_of(codec.encode(kf), config=IngestConfig(max_features=8))
    assert code == Code.TOO_MANY_FEATURES


def test_keypoints_of_a_second_kind_lie_in_the_image() -> None:
    outside = Features(FeatureType.SIFT, np.array([[0.0, 480.0]], "f4"), np.zeros((1, 128), "u1"))
    kf = dataclasses.replace(keyframe(), more_features=(outside,))
    assert code_of(codec.encode(kf)) == Code.KEYPOINT_OUTSIDE


def test_a_kind_that_is_there_twice() -> None:
    two = dataclasses.replace(keyframe(), more_features=(sift_features(3),))
    fields = read(codec.encode(two), "Keyframe")
    fields["more_features"] = [fields["features"]]
    assert code_of(write("Keyframe", fields)) == Code.MALFORMED


def test_wrong_descriptor_length() -> None:
    payload = bytearray(codec.encode(dataclasses.replace(keyframe(), features=sift_features(2))))
    # Bytes of 256 descriptor values behind the length: claim one less.
    at = payload.index((256).to_bytes(4, "little"))
    payload[at : at + 4] = (255).to_bytes(4, "little")
    assert code_of(bytes(payload)) == Code.MALFORMED


def test_a_pose_that_is_not_finite() -> None:
    x = np.array([3.0]).tobytes()
    payload = message(3)
    assert payload.count(x) == 1
    assert code_of(payload.replace(x, np.array([np.nan]).tobytes())) == Code.MALFORMED


def test_truncated_at_every_length() -> None:
    payload = message()
    for length in range(len(payload)):
        answer = admit_upload("a0", payload[:length], KNOWN, CONFIG)
        if isinstance(answer, AdmittedUpload):  # only padding was cut
            assert codec.encode(answer.item) == payload
            assert not any(payload[length:])
        else:
            assert isinstance(answer, Rejected)
    assert code_of(payload[: len(payload) // 2]) == Code.MALFORMED


def test_other_messages_are_no_uploads() -> None:
    assert code_of(codec.encode(CAMERA)) == Code.MALFORMED
    assert code_of(b"") == Code.MALFORMED


@given(st.binary(max_size=200))
def test_random_bytes(payload: bytes) -> None:
    assert code_of(payload) == Code.MALFORMED
    camera = admit_camera("a0", payload)
    assert isinstance(camera, Rejected)
    assert camera.code == Code.MALFORMED


@given(st.data())
def test_flipped_bytes_never_do_more_than_change_the_answer(data: st.DataObject) -> None:
    payload = bytearray(message())
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    answer = admit_upload("a0", bytes(payload), KNOWN, CONFIG)
    assert isinstance(answer, AdmittedUpload | NeedCamera | Rejected)
    codec.encode(answer.item if isinstance(answer, AdmittedUpload) else answer)


def test_cameras() -> None:
    answer = admit_camera("a0", codec.encode(CAMERA))
    assert isinstance(answer, AdmittedCamera)
    assert answer.agent == "a0"
    assert answer.camera.hash == CAMERA.hash
    fisheye = Camera("OPENCV_FISHEYE", 640, 480, np.ones(8), np.eye(4))
    assert isinstance(admit_camera("a0", codec.encode(fisheye)), AdmittedCamera)
    malformed = admit_camera("a0", message())
    assert isinstance(malformed, Rejected)
    assert malformed.code == Code.MALFORMED


def test_reasons_that_quote_what_was_sent_are_cut() -> None:
    assert rejected(Code.MALFORMED, "x" * 100_000).reason == "x" * 200


def test_every_code_can_go_on_the_wire() -> None:
    for code in Code:
        reply = Rejected(code.value, "why")
        assert codec.decode_upload_reply(codec.encode(reply)) == reply
