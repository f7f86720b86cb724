"""Every message comes out of the codec as it went in."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from covinz import codec, frames, types
from covinz.codec import poses
from covinz.codec.reader import read
from tests.contract.examples import CAND, EXAMPLES, GAP, KEYFRAME, OLD, kind_of, same, turn
from tests.unit.covinz.messages import keyframes, messages, poses_of


def decode(payload: bytes, like: Any) -> Any:
    kind = kind_of(like)
    return codec.decode_upload_reply(payload) if kind is None else codec.decode(payload, kind)


def orb(keypoints_px: Any, descriptors: Any) -> types.Features:
    return types.Features(types.FeatureType.ORB, keypoints_px, descriptors)


@settings(max_examples=200)
@given(messages)
def test_round_trip(message: Any) -> None:
    payload = codec.encode(message)
    once = decode(payload, message)
    assert codec.encode(once) == payload
    assert same(decode(codec.encode(once), message), once)
    assert same(once, message, rotation_tolerance=2e-13)


@given(keyframes)
def test_equal_values_give_equal_bytes(kf: types.Keyframe) -> None:
    copy = dataclasses.replace(kf, T_odom_body=kf.T_odom_body.copy())
    assert codec.encode(copy) == codec.encode(kf)


def test_counters_are_sorted() -> None:
    forth = types.Status("s", "i", "", 0, 0, 0, False, {"a": 1.0, "b": 2.0})
    back = types.Status("s", "i", "", 0, 0, 0, False, {"b": 2.0, "a": 1.0})
    assert codec.encode(forth) == codec.encode(back)


@given(st.integers(0, 2**32))
def test_poses_survive_further_trips_to_the_last_bit(seed: int) -> None:
    T = poses_of(np.random.default_rng(seed), (50,))
    wire = poses.pose_values(T, "T")
    back = poses.transforms(wire, "T")
    np.testing.assert_array_equal(poses.pose_values(back, "T"), wire)
    np.testing.assert_array_equal(back[:, :3, 3], T[:, :3, 3])
    np.testing.assert_allclose(back, T, rtol=0, atol=2e-13)
    one_by_one = np.array([poses.pose_values(one, "T") for one in T])
    np.testing.assert_array_equal(one_by_one, wire)


@given(st.integers(0, 2**32))
def test_both_signs_of_a_quaternion_are_one_rotation(seed: int) -> None:
    wire = poses.pose_values(poses_of(np.random.default_rng(seed), (20,)), "T")
    negated = np.concatenate([wire[:, :3], -wire[:, 3:]], axis=-1)
    again = poses.pose_values(poses.transforms(negated, "T"), "T")
    np.testing.assert_array_equal(again, wire)


def test_calibration_keeps_its_hash() -> None:
    rotation = frames.so3_exp(np.array([0.1, -2.0, 0.3]))
    T_body_cam = frames.transform(rotation, [0.01, 0.02, 1 / 3])
    camera = types.Camera("PINHOLE", 640, 480, np.array([500.1, 500.2, 319.7, 240.1]), T_body_cam)
    assert codec.decode(codec.encode(camera), types.Camera).hash == camera.hash


def test_keypoints_are_rounded_to_a_sixteenth_of_a_pixel() -> None:
    features = orb(np.array([[0.03, 100.04]]), np.zeros((1, 32)))
    kf = codec.decode(
        codec.encode(dataclasses.replace(KEYFRAME, features=features)), types.Keyframe
    )
    assert kf.features is not None
    np.testing.assert_array_equal(kf.features.keypoints_px, np.array([[0, 100.0625]], "f4"))


def test_thousand_orb_features_fit_in_forty_kilobytes() -> None:
    rng = np.random.default_rng(0)
    features = orb(rng.uniform(0, 640, (1000, 2)), rng.integers(0, 256, (1000, 32)))
    assert len(codec.encode(dataclasses.replace(KEYFRAME, features=features))) < 40_000


def test_decoded_arrays_are_read_only_and_do_not_hold_the_payload() -> None:
    kf = codec.decode(codec.encode(KEYFRAME), types.Keyframe)
    assert kf.features is not None
    for array in (kf.T_odom_body, kf.features.descriptors, kf.features.keypoints_px):
        assert not array.flags.writeable
        assert array.base is None


def test_upload_is_told_apart_by_its_identifier() -> None:
    assert same(codec.decode_upload(codec.encode(KEYFRAME)), KEYFRAME)
    assert same(codec.decode_upload(codec.encode(GAP)), GAP)
    with pytest.raises(codec.MalformedMessage, match="got a LogHead"):
        codec.decode_upload(codec.encode(EXAMPLES["LogHead"]))


@pytest.mark.parametrize("name", ["LoopClosure", "Rejection"])
def test_outcome_is_told_apart_by_its_identifier(name: str) -> None:
    assert same(codec.decode_outcome(codec.encode(EXAMPLES[name])), EXAMPLES[name])


@pytest.mark.parametrize("name", [name for name in EXAMPLES if name.startswith("UploadReply")])
def test_upload_reply(name: str) -> None:
    assert same(codec.decode_upload_reply(codec.encode(EXAMPLES[name])), EXAMPLES[name])


def test_log_page_holds_the_stored_messages_as_they_are() -> None:
    stored = [(17, codec.encode(KEYFRAME)), (18, codec.encode(GAP))]
    payload = codec.encode_log_page(OLD, 19, stored)
    assert payload == codec.encode(EXAMPLES["LogPage"])
    messages = read(payload, "LogPage")["messages"].tobytes()
    assert messages == stored[0][1] + stored[1][1]


def test_log_page_says_which_entry_is_bad() -> None:
    payload = codec.encode_log_page(OLD, 2, [(0, codec.encode(GAP)), (1, b"rubbish rubbish")])
    with pytest.raises(codec.MalformedMessage, match="entry 1: no covinz message"):
        codec.decode(payload, types.LogPage)


@pytest.mark.parametrize(
    ("head", "indices"), [(9, [0, 2]), (9, [3, 2]), (1, [0, 1]), (2**63, [0]), (9, [-1, 0])]
)
def test_log_page_refuses_other_than_consecutive_entries(head: int, indices: list[int]) -> None:
    with pytest.raises(ValueError, match=r"log_index|head|first"):
        codec.encode_log_page(OLD, head, [(index, codec.encode(GAP)) for index in indices])


def test_pose_view_has_neither_features_nor_thumbnail() -> None:
    pose = codec.without_features(KEYFRAME)
    assert pose.features is None
    assert pose.thumbnail_jpeg is None
    assert same(dataclasses.replace(KEYFRAME, features=None, thumbnail_jpeg=None), pose)
    again = codec.decode(codec.encode(pose), types.Keyframe)
    assert again.features is None


def test_no_features_and_unknown_features_differ() -> None:
    empty = types.Features(types.FeatureType.SIFT, np.zeros((0, 2), "f4"), np.zeros((0, 128), "u1"))
    kf = types.Keyframe(CAND, 0, turn(0, 0, 0), "0" * 16, empty)
    again = codec.decode(codec.encode(kf), types.Keyframe)
    assert again.features is not None
    assert again.features.type is types.FeatureType.SIFT
    assert len(again.features) == 0


def test_other_objects_are_no_messages() -> None:
    with pytest.raises(TypeError, match="KeyframeId is not a message"):
        codec.encode(CAND)


def test_schema_name_of_rubbish() -> None:
    with pytest.raises(codec.MalformedMessage):
        codec.schema_name(b"\0\0\0\0XXXX")
    with pytest.raises(codec.MalformedMessage):
        codec.schema_name(b"")
