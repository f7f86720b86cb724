"""Values check their shapes, cannot be changed, and have stable names and hashes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz import types
from covinz.types import Camera, FeatureType, KeyframeId, frozen_array
from tests.contract.examples import CAND, KEYFRAME, LOOP_JOB, OLD, QUERY
from tests.unit.covinz.messages import keyframe_ids


def camera(**changes: Any) -> Camera:
    fixed = Camera("PINHOLE", 640, 480, np.array([500.0, 501, 320, 240]), np.eye(4))
    return dataclasses.replace(fixed, **changes)


@given(keyframe_ids)
def test_keyframe_id_is_parsed_from_its_text(keyframe_id: KeyframeId) -> None:
    assert KeyframeId.parse(str(keyframe_id)) == keyframe_id


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a",
        f"a/{OLD}",
        f"a/{OLD}/1/2",
        f"A/{OLD}/1",
        f"-a/{OLD}/1",
        f"{'a' * 33}/{OLD}/1",
        f"a/{OLD[:-1]}/1",
        f"a/{OLD.lower()}/1",
        f"a/8{OLD[1:]}/1",
        f"a/{OLD}/",
        f"a/{OLD}/-1",
        f"a/{OLD}/+1",
        f"a/{OLD}/01",
        f"a/{OLD}/1_0",
        f"a/{OLD}/ 1",
        f"a/{OLD}/\N{ARABIC-INDIC DIGIT ONE}",
        f"a/{OLD}/{2**63}",
        f"a/{OLD}/{'9' * 5000}",
        f"a\n/{OLD}/1",
        f"*/{OLD}/1",
    ],
)
def test_other_texts_are_no_keyframe_ids(text: str) -> None:
    with pytest.raises(ValueError, match="not a keyframe id"):
        KeyframeId.parse(text)


@given(st.text())
def test_any_text_is_parsed_or_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not a keyframe id"):
        KeyframeId.parse(text)


def test_keyframes_of_a_session_share_a_segment() -> None:
    other = KeyframeId(QUERY.agent, QUERY.session, QUERY.seq + 1)
    assert QUERY.segment == other.segment != CAND.segment
    assert str(CAND.segment) == f"robot_1/{OLD}"


def test_calibration_hash_is_stable() -> None:
    assert camera().hash == "ac9d820e4f221f15"


@pytest.mark.parametrize(
    "changes",
    [
        {"model": "OPENCV"},
        {"width": 641},
        {"height": 481},
        {"params": np.array([500.0, 501, 320, np.nextafter(240, 241)])},
        {"T_body_cam": np.diag([1.0, 1, 1, 1]) + 1e-15 * np.eye(4, k=3)},
    ],
)
def test_calibration_hash_covers_everything(changes: dict[str, Any]) -> None:
    assert camera(**changes).hash != camera().hash


def test_arrays_are_copied_and_read_only() -> None:
    pose = np.eye(4)
    kf = dataclasses.replace(KEYFRAME, T_odom_body=pose)
    pose[0, 3] = 5
    assert kf.T_odom_body[0, 3] == 0
    with pytest.raises(ValueError, match="read-only"):
        kf.T_odom_body[0, 3] = 5
    with pytest.raises(dataclasses.FrozenInstanceError):
        kf.stamp_ns = 1  # type: ignore[misc]


@pytest.mark.parametrize("shape", [(3, 4), (4, 4, 1), (16,)])
def test_wrong_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected an array of shape"):
        dataclasses.replace(KEYFRAME, T_odom_body=np.zeros(shape))


@pytest.mark.parametrize("kind", list(FeatureType))
def test_descriptors_have_the_length_of_their_type(kind: FeatureType) -> None:
    keypoints = np.zeros((2, 2), "f4")
    length = {"ORB": 32, "SIFT": 128}[kind.name]
    assert len(types.Features(kind, keypoints, np.zeros((2, length), "u1"))) == 2
    for shape in ((2, length - 1), (1, length), (3, length)):
        with pytest.raises(ValueError, match="expected an array of shape"):
            types.Features(kind, keypoints, np.zeros(shape, "u1"))


def test_a_keyframe_has_one_block_a_kind() -> None:
    orb = types.Features(FeatureType.ORB, np.zeros((2, 2), "f4"), np.zeros((2, 32), "u1"))
    sift = types.Features(FeatureType.SIFT, np.zeros((3, 2), "f4"), np.zeros((3, 128), "u1"))
    both = dataclasses.replace(KEYFRAME, features=orb, more_features=(sift,))
    assert both.all_features == (orb, sift)
    assert both.features_of(FeatureType.SIFT) is sift
    assert dataclasses.replace(KEYFRAME, features=sift).features_of(FeatureType.ORB) is None
    assert dataclasses.replace(KEYFRAME, features=None).all_features == ()
    for features, more in ((orb, (orb,)), (orb, (sift, sift)), (None, (sift,))):
        with pytest.raises(ValueError, match="more_features"):
            dataclasses.replace(KEYFRAME, features=features, more_features=more)
    with pytest.raises(ValueError, match="there twice"):
        types.KeyframeContent(0, np.eye(4), camera(), sift, more_features=(sift,))


@pytest.mark.parametrize("value", [-1, 256, 1.5, float("nan")])
def test_bytes_do_not_wrap_around(value: float) -> None:
    with pytest.raises(ValueError, match="not all values are uint8"):
        frozen_array(np.array([1, value]), (2,), "u1")


def test_whole_numbers_of_another_type_are_taken() -> None:
    array = frozen_array(np.array([0.0, 255.0]), (2,), "u1")
    assert array.dtype == np.uint8
    assert array.tolist() == [0, 255]


def test_job_names_its_keyframes_and_seed() -> None:
    assert LOOP_JOB.query == QUERY
    assert LOOP_JOB.cand == CAND
    assert LOOP_JOB.seed == 0x0123456789ABCDEF
