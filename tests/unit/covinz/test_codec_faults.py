"""Bad bytes and bad values raise MalformedMessage, and nothing else, in little time and memory."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any

import flatbuffers
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from covinz import codec, types
from covinz.codec.layout import IDENTIFIERS, TABLES, Table
from covinz.codec.reader import message_name, read, read_table
from covinz.codec.writer import write
from tests.contract.examples import EXAMPLES, KEYFRAME, SNAPSHOT, kind_of, same
from tests.unit.covinz.flatbuffers_writer import write_table

PAYLOADS = {name: codec.encode(message) for name, message in EXAMPLES.items()}
EVERY = pytest.mark.parametrize("name", EXAMPLES)
KINDS = [kind for kind in {kind_of(message) for message in EXAMPLES.values()} if kind is not None]


def decode(payload: bytes, name: str) -> Any:
    kind = kind_of(EXAMPLES[name])
    return codec.decode_upload_reply(payload) if kind is None else codec.decode(payload, kind)


def decode_or_refuse(payload: bytes, name: str) -> Any:
    """The decoded value, or None when it is refused as it should be."""
    try:
        return decode(payload, name)
    except codec.MalformedMessage:
        return None


# --- bytes ----------------------------------------------------------------------------------


@EVERY
def test_truncated(name: str) -> None:
    payload = PAYLOADS[name]
    for length in range(len(payload)):
        message = decode_or_refuse(payload[:length], name)
        # The last bytes of a message may be padding, which nobody misses.
        assert message is None or (same(message, EXAMPLES[name]) and not any(payload[length:]))


@EVERY
def test_bytes_changed_one_by_one(name: str) -> None:
    payload = PAYLOADS[name]
    for position in range(0, len(payload), 1 + len(payload) // 1024):
        for bits in (0x01, 0x80, 0xFF):
            changed = bytearray(payload)
            changed[position] ^= bits
            decode_or_refuse(bytes(changed), name)


@settings(max_examples=300)
@given(
    st.sampled_from(sorted(PAYLOADS)),
    st.lists(st.tuples(st.integers(0, 2**16), st.integers(0, 255)), min_size=1, max_size=12),
)
def test_random_bytes_changed(name: str, changes: list[tuple[int, int]]) -> None:
    changed = bytearray(PAYLOADS[name])
    for position, value in changes:
        changed[position % len(changed)] = value
    decode_or_refuse(bytes(changed), name)


@settings(max_examples=300)
@given(st.sampled_from(sorted(PAYLOADS)), st.integers(0, 2**16), st.integers(0, 2**32 - 1))
def test_random_words_changed(name: str, position: int, word: int) -> None:
    changed = bytearray(PAYLOADS[name])
    struct.pack_into("<I", changed, 4 * (position % (len(changed) // 4)), word)
    decode_or_refuse(bytes(changed), name)


@given(st.sampled_from(KINDS), st.binary(max_size=200))
@example(types.Keyframe, b"")
def test_random_bytes(kind: type[Any], payload: bytes) -> None:
    with pytest.raises(codec.MalformedMessage):
        codec.decode(payload, kind)


@given(st.sampled_from(sorted(IDENTIFIERS)), st.binary(min_size=4, max_size=400))
def test_random_bytes_after_a_good_identifier(name: str, noise: bytes) -> None:
    kind = next((kind for kind in KINDS if kind.__name__ == name), None)
    payload = noise[:4] + IDENTIFIERS[name] + noise[4:]
    with contextlib.suppress(codec.MalformedMessage):
        codec.decode_upload_reply(payload) if kind is None else codec.decode(payload, kind)


@EVERY
def test_other_message(name: str) -> None:
    for other, payload in PAYLOADS.items():
        if message_name(payload) != message_name(PAYLOADS[name]):
            with pytest.raises(codec.MalformedMessage, match="expected a"):
                decode(payload, name)
        else:
            assert decode(payload, name) is not None, other


def test_vector_longer_than_the_payload() -> None:
    payload = PAYLOADS["Keyframe"]
    descriptors = payload.index(struct.pack("<I", 96) + bytes(range(8)))
    for length in (97, 2**16, 2**31, 2**32 - 1):
        changed = bytearray(payload)
        struct.pack_into("<I", changed, descriptors, length)
        with pytest.raises(codec.MalformedMessage, match="descriptors"):
            codec.decode(bytes(changed), types.Keyframe)


def test_many_offsets_to_the_same_data() -> None:
    """A page of jobs that all point to one record is refused before it grows."""
    record = read(PAYLOADS["JobPage"], "JobPage")["records"][1]
    builder = flatbuffers.Builder()
    offset = write_table(builder, TABLES["JobRecord"], record)
    builder.StartVector(4, 4096, 4)
    for _ in range(4096):
        builder.PrependUOffsetTRelative(offset)
    records = builder.EndVector()
    builder.StartObject(3)
    builder.PrependUOffsetTRelativeSlot(2, records, 0)
    builder.Finish(builder.EndObject(), IDENTIFIERS["JobPage"])
    payload = bytes(builder.Output())
    tracemalloc.start()
    try:
        with pytest.raises(codec.MalformedMessage, match="8 times its size"):
            codec.decode(payload, types.JobPage)
        assert tracemalloc.get_traced_memory()[1] < 50 * len(payload)
    finally:
        tracemalloc.stop()


def tables_in(fields: Any, table: Table) -> Iterator[tuple[Table, Any]]:
    """The table and all below it, with their fields."""
    yield table, fields
    for field in table.fields:
        value = fields[field.name]
        if field.kind == "table" and value is not None:
            yield from tables_in(value, TABLES[field.type])
        elif field.kind == "tables":
            for item in value or ():
                yield from tables_in(item, TABLES[field.type])
        elif field.kind == "union" and value is not None:
            yield from tables_in(value[1], TABLES[value[0]])


def test_required_fields_are_required() -> None:
    tested = set()
    for payload in PAYLOADS.values():
        name = message_name(payload)
        for table, fields in tables_in(read(payload, name), TABLES[name]):
            for field in (field for field in table.fields if field.required):
                builder = flatbuffers.Builder()
                root = write_table(builder, table, {**fields, field.name: None})
                builder.Finish(root, b"TEST")
                missing = f"{table.name}.{field.name} is missing"
                with pytest.raises(codec.MalformedMessage, match=missing):
                    read_table(bytes(builder.Output()), table)
                tested.add((table.name, field.name))
    every = {(t.name, field.name) for t in TABLES.values() for field in t.fields if field.required}
    assert tested == every


# --- values ---------------------------------------------------------------------------------

NAN, INF = float("nan"), float("inf")


def put(*path: Any) -> Callable[[Any], None]:
    """A change of fields: the last element of `path` becomes the value at the ones before."""
    *keys, last, value = path

    def change(fields: Any) -> None:
        for key in keys:
            fields = fields[key]
        if isinstance(fields[last], tuple) and isinstance(value, dict):
            numbers = list(fields[last])
            for i, number in value.items():
                numbers[i] = number
            fields[last] = tuple(numbers)
        elif isinstance(fields[last], np.ndarray) and isinstance(value, dict):
            fields[last] = fields[last].copy()
            for i, number in value.items():
                fields[last][i] = number
        else:
            fields[last] = value

    return change


U32 = np.array([0, 0, 5], "u4")
BAD_FIELDS: list[tuple[str, Callable[[Any], None]]] = [
    ("Camera", put("model", "SIMPLE_PINHOLE")),
    ("Camera", put("width", 0)),
    ("Camera", put("height", 4097)),
    ("Camera", put("params", np.ones(7))),
    ("Camera", put("params", {0: -500.0})),
    ("Camera", put("params", {5: NAN})),
    ("Camera", put("matrix_body_cam", np.ones(11))),
    ("Camera", put("matrix_body_cam", {0: 1e200})),
    ("Camera", put("matrix_body_cam", {3: INF})),
    ("Camera", put("matrix_body_cam", {4: -1.0})),
    ("Keyframe", put("id", "agent", "Robot")),
    ("Keyframe", put("id", "agent", "a/b")),
    ("Keyframe", put("id", "agent", "a" * 33)),
    ("Keyframe", put("id", "session", "01ARZ3NDEKTSV4RRFFQ69G5FAU"[:25])),
    ("Keyframe", put("id", "session", "81ARZ3NDEKTSV4RRFFQ69G5FAV")),
    ("Keyframe", put("id", "seq", 2**63)),
    ("Keyframe", put("stamp_ns", -1)),
    ("Keyframe", put("pose_odom_body", {0: NAN})),
    ("Keyframe", put("pose_odom_body", {1: 1.1e9})),
    ("Keyframe", put("pose_odom_body", {3: NAN})),
    ("Keyframe", put("pose_odom_body", {3: 1e300})),
    ("Keyframe", put("pose_odom_body", {3: 0.5001})),
    ("Keyframe", put("pose_odom_body", dict.fromkeys(range(3, 7), 0.0))),
    ("Keyframe", put("camera_hash", "00112233AABBCCDD")),
    ("Keyframe-two_kinds", put("features", None)),
    ("Keyframe-two_kinds", put("features", "type", "Sift")),
    ("Keyframe-two_kinds", lambda fields: fields["more_features"].append(fields["features"])),
    ("Keyframe-two_kinds", lambda fields: fields.update(more_features=[fields["features"]])),
    ("Keyframe-two_kinds", put("more_features", 0, "type", None)),
    ("Keyframe-two_kinds", put("more_features", 0, "type", "Orb")),
    ("Keyframe-two_kinds", put("more_features", 0, "keypoints", np.zeros(4, "u2"))),
    ("Keyframe-two_kinds", put("more_features", 0, "descriptors", np.zeros(127, "u1"))),
    ("Keyframe", put("features", "type", None)),
    ("Keyframe", put("features", "type", "Sift")),
    ("Keyframe", put("features", "keypoints", np.zeros(5, "u2"))),
    ("Keyframe", put("features", "keypoints", np.zeros(8, "u2"))),
    ("Keyframe", put("features", "descriptors", np.zeros(95, "u1"))),
    ("Keyframe", put("features", "descriptors", np.zeros(0, "u1"))),
    ("Keyframe", put("covariance", np.eye(5).ravel())),
    ("Keyframe", put("covariance", {0: NAN})),
    ("Keyframe", put("covariance", {0: 1e19})),
    ("Keyframe", put("covariance", {1: 0.5})),
    ("Keyframe", put("covariance", -np.eye(6).ravel())),
    ("Keyframe", put("gravity_body", np.zeros(3))),
    ("Keyframe", put("gravity_body", np.array([1e300, 0, 0]))),
    ("Keyframe", put("gravity_body", np.array([0.0, 1.0]))),
    ("Gap", put("last_seq", 2)),
    ("Gap", put("agent", "")),
    ("Gap", put("session", "")),
    ("UploadReply-retry_after", put("answer", ("RetryAfter", {"seconds": -1.0, "reason": ""}))),
    ("UploadReply-retry_after", put("answer", ("RetryAfter", {"seconds": NAN, "reason": ""}))),
    ("UploadReply-need_camera", put("answer", ("NeedCamera", {"camera_hash": "0"}))),
    ("UploadReply-rejected", put("answer", ("Rejected", {"code": "A b", "reason": ""}))),
    ("LogRange", put("start", 2**63)),
    ("LogRange", put("view", None)),
    ("LogPage", put("log_id", "x")),
    ("LogPage", put("head", 18)),
    ("LogPage", put("first", None)),
    ("LogPage", put("first", 2**63)),
    ("LogPage", put("ends", np.array([8, 8], "u4"))),
    ("LogPage", put("ends", np.array([], "u4"))),
    ("LogPage", put("ends", {1: 2**32 - 1})),
    ("LogPage", put("messages", np.zeros(0, "u1"))),
    ("LogPage-empty", put("messages", np.zeros(8, "u1"))),
    ("LogPage-empty", put("first", 3)),
    ("LogHead", put("head", 2**64 - 1)),
    ("LeaseRequest", put("worker", "a/b")),
    ("LeaseRequest", put("worker", "")),
    ("Lease", put("attempt", 0)),
    ("Lease", put("duration_s", INF)),
    ("LoopJob", put("id", "0" * 31)),
    ("LoopJob", put("query_rig", [])),
    ("LoopJob", put("cand_rig", [])),
    ("LoopJob", put("score", NAN)),
    ("LoopJob", put("cand_rig", 0, "camera_hash", "")),
    ("LoopJob-motions", put("query_rig", 0, "motion_covariance", np.zeros(36))),
    ("LoopJob-motions", put("query_rig", 0, "motion_covariance", np.eye(6).ravel()[:35])),
    ("LoopJob-motions", put("query_rig", 0, "motion_covariance", {7: NAN})),
    ("LoopClosure", put("covariance", np.zeros(36))),
    ("LoopClosure", put("covariance", {35: -1.0})),
    ("LoopClosure", put("solver_ms", -1.0)),
    ("LoopClosure", put("query", "agent", "-")),
    ("Rejection", put("stage", "")),
    ("Rejection", put("count", NAN)),
    ("Rejection", put("threshold", INF)),
    ("JobDone-loop", put("worker", "*")),
    ("JobRange", put("first", 2**63)),
    ("JobPage", put("records", 0, "state", None)),
    ("JobPage", put("total", 2**63)),
    ("Correction", put("pose_map_odom", {6: -0.6})),
    ("Correction", put("map_id", "1")),
    ("Correction", put("map_revision", 2**63)),
    ("Correction", put("stamp_ns", -5)),
    ("MapList", put("maps", 0, "segments", [])),
    ("MapSnapshot", put("keyframe_segment", np.array([0, 0, 2], "u4"))),
    ("MapSnapshot", put("keyframe_segment", np.array([0, 0], "u4"))),
    ("MapSnapshot", put("keyframe_seq", {0: 2**63})),
    ("MapSnapshot", put("stamps_ns", {0: -1})),
    ("MapSnapshot", put("poses_map_body", {3: 1.0})),
    ("MapSnapshot", put("poses_odom_body", np.zeros(20))),
    ("MapSnapshot", put("edge_from", {0: 3})),
    ("MapSnapshot", put("edge_to", {0: 2**32 - 1})),
    ("MapSnapshot", put("edge_to", U32)),
    ("MapSnapshot", put("poses_from_to", {0: NAN})),
    ("MapSnapshot", put("information", {0: INF})),
    ("MapSnapshot", put("is_loop", np.array([True]))),
    ("Status", put("log_id", "")),
    ("Status", put("cursor", 2**63)),
    ("Status", put("service", "a b")),
    ("Status", put("counters", 0, "value", NAN)),
    ("Status", put("counters", 0, "name", "zzz")),
    ("Status", put("counters", 0, "name", "bytes")),
]


@pytest.mark.parametrize(("name", "change"), BAD_FIELDS)
def test_bad_values_are_refused(name: str, change: Callable[[Any], None]) -> None:
    message = message_name(PAYLOADS[name])
    fields = copy.deepcopy(read(PAYLOADS[name], message))
    assert write(message, fields) == PAYLOADS[name]
    change(fields)
    with pytest.raises(codec.MalformedMessage):
        decode(write(message, fields), name)


def with_pose(pose: Any) -> types.Keyframe:
    return dataclasses.replace(KEYFRAME, T_odom_body=pose)


def with_keypoint(x: float) -> types.Keyframe:
    features = types.Features(
        types.FeatureType.ORB, np.array([[x, 5]], "f4"), np.zeros((1, 32), "u1")
    )
    return dataclasses.replace(KEYFRAME, features=features)


EYE = np.eye(4)
HALF: Any = 0.5
BAD_MESSAGES: list[tuple[Any, str]] = [
    (with_keypoint(-0.04), "keypoint"),
    (with_keypoint(4096), "keypoint"),
    (with_keypoint(NAN), "keypoint"),
    (with_pose(2 * EYE), "rigid"),
    (with_pose(np.diag([1.0, 1, -1, 1])), "rigid"),
    (with_pose(EYE + 1e-3 * np.eye(4, k=-3)), "rigid"),
    (with_pose(EYE * NAN), "translation"),
    (with_pose(EYE + 1e10 * np.eye(4, k=3)), "translation"),
    (dataclasses.replace(KEYFRAME, stamp_ns=2**63), "stamp_ns"),
    (dataclasses.replace(KEYFRAME, stamp_ns=HALF), "stamp_ns"),
    (dataclasses.replace(KEYFRAME, camera_hash=""), "camera_hash"),
    (dataclasses.replace(EXAMPLES["LoopClosure"], num_inliers=-1), "num_inliers"),
    (dataclasses.replace(EXAMPLES["LoopClosure"], num_matches=2**32), "num_matches"),
    (dataclasses.replace(EXAMPLES["Rejection"], count=NAN), "count"),
    (dataclasses.replace(EXAMPLES["Gap"], reason="\ud800"), "surrogates"),
    (dataclasses.replace(SNAPSHOT, edge_to=np.array([1, 3])), "edges"),
    (dataclasses.replace(SNAPSHOT, information=np.triu(np.ones((2, 6, 6)))), "symmetric"),
    (dataclasses.replace(SNAPSHOT, keyframes=(types.KeyframeId("x", "y", 0),) * 3), "segment"),
]


@pytest.mark.parametrize(("message", "reason"), BAD_MESSAGES)
def test_bad_values_are_not_sent(message: Any, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        codec.encode(message)
