"""The ingest process over a real router: what it answers, to good and to bad input."""

from __future__ import annotations

import dataclasses
import queue
import random
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from covinz import codec, keyexprs
from covinz.agent import Agent
from covinz.types import (
    Duplicate,
    Features,
    FeatureType,
    Keyframe,
    KeyframeId,
    LogHead,
    LogView,
    NeedCamera,
    Rejected,
    Stored,
    UploadReply,
)
from tests.processes import PATIENCE_S, Processes
from tests.uploads import CAMERA, SESSION, content, keyframe, message


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    with Processes(tmp_path_factory.mktemp("server")) as server:
        server.start("router", "ingest")
        yield server


def upload(server: Processes, payload: bytes, agent: str) -> UploadReply:
    (reply,) = server.bus.ask(keyexprs.agent_keyframe(agent), payload)
    return codec.decode_upload_reply(reply)


def register(server: Processes, agent: str, payload: bytes | None = None) -> UploadReply:
    payload = codec.encode(CAMERA) if payload is None else payload
    (reply,) = server.bus.ask(keyexprs.agent_camera(agent), payload)
    return codec.decode_upload_reply(reply)


def with_wrong_descriptor_length(agent: str) -> bytes:
    """A keyframe that claims one byte of descriptors less than its keypoints need."""
    features = Features(FeatureType.SIFT, np.zeros((2, 2), np.float32), np.ones((2, 128), np.uint8))
    payload = bytearray(codec.encode(dataclasses.replace(keyframe(0, agent), features=features)))
    at = payload.index((256).to_bytes(4, "little"))
    payload[at : at + 4] = (255).to_bytes(4, "little")
    return bytes(payload)


def with_nan_pose(agent: str) -> bytes:
    x = np.array([3.0]).tobytes()
    payload = message(3, agent)
    assert payload.count(x) == 1
    return payload.replace(x, np.array([np.nan]).tobytes())


def of_an_unknown_camera(agent: str) -> bytes:
    return codec.encode(dataclasses.replace(keyframe(0, agent), camera_hash="0123456789abcdef"))


BAD_UPLOADS = {
    "wrong descriptor length": (with_wrong_descriptor_length("bad"), "malformed"),
    "NaN pose": (with_nan_pose("bad"), "malformed"),
    "truncated": (message(0, "bad")[:200], "malformed"),
    "random bytes": (random.Random(1).randbytes(5000), "malformed"),
    "random bytes with our identifier": (
        b"\x10\0\0\0KFR1" + random.Random(2).randbytes(5000),
        "malformed",
    ),
    "empty": (b"", "malformed"),
    "a camera": (codec.encode(CAMERA), "malformed"),
    "foreign agent": (message(0, "good"), "foreign_agent"),
    "too large": (bytes(1024 * 1024 + 1), "too_large"),
    "no features": (codec.encode(codec.without_features(keyframe(0, "bad"))), "no_features"),
    "too many features": (message(0, "bad", num_features=9000), "too_many_features"),
}


def test_bad_input_is_answered_by_type_and_harms_nobody_else(
    server: Processes, tmp_path: Path
) -> None:
    with Agent("good", server.endpoint, tmp_path / "good.spool") as good:
        sent = 0
        for name, (payload, code) in BAD_UPLOADS.items():
            good.send(content(sent))
            sent += 1
            answer = upload(server, payload, "bad")
            assert isinstance(answer, Rejected), name
            assert answer.code == code, name
            assert answer.reason, name
        unknown = upload(server, of_an_unknown_camera("bad"), "bad")
        assert unknown == NeedCamera("0123456789abcdef")
        assert good.wait_delivered(PATIENCE_S)
        seqs = [
            entry.item.id.seq
            for entry in server.log_entries()
            if isinstance(entry.item, Keyframe) and entry.item.id.session == good.session
        ]
        assert sorted(seqs) == list(range(sent))
        assert not [
            entry
            for entry in server.log_entries()
            if isinstance(entry.item, Keyframe) and entry.item.id.agent == "bad"
        ]
    counters = server.status("ingest").counters
    assert counters["rejected.malformed"] >= 7
    assert counters["rejected.foreign_agent"] == 1
    assert counters["keyframes.good"] == sent
    assert "keyframes.bad" not in counters


def test_bad_cameras(server: Processes) -> None:
    for payload, code in (
        (b"", "malformed"),
        (codec.encode(CAMERA)[:-40], "malformed"),
    ):
        answer = register(server, "bad", payload)
        assert isinstance(answer, Rejected)
        assert answer.code == code


def test_uploads_to_wildcards_are_rejected(server: Processes) -> None:
    for key in ("covinz/agent/*/up/keyframe", "covinz/agent/Bad!/up/keyframe"):
        (reply,) = server.bus.ask(key, message(0, "bad"))
        answer = codec.decode_upload_reply(reply)
        assert isinstance(answer, Rejected)
        assert answer.code == "bad_key"


def test_a_keyframe_and_what_can_be_asked_about_it(server: Processes) -> None:
    heads: queue.SimpleQueue[LogHead] = queue.SimpleQueue()
    subscription = server.bus.subscribe(
        keyexprs.LOG_HEAD, lambda _, payload: heads.put(codec.decode(payload, LogHead))
    )
    assert isinstance(register(server, "a0"), Stored | Duplicate)
    before = server.status("ingest")
    assert upload(server, message(5), "a0") == Stored()
    assert upload(server, message(5), "a0") == Duplicate()
    conflict = upload(server, message(5, num_features=4), "a0")
    assert isinstance(conflict, Rejected)
    assert conflict.code == "conflict"

    after = server.status("ingest")
    assert after.cursor == before.cursor + 1
    assert after.log_id == before.log_id
    for view in LogView:
        newest = server.log_entries(view)[-1]
        assert newest.log_index == before.cursor
        assert isinstance(newest.item, Keyframe)
        assert newest.item.id == keyframe(5).id
        assert (newest.item.features is None) == (view is LogView.POSE)
    assert server.bus.ask(keyexprs.keyframe(keyframe(5).id)) == [message(5)]
    assert server.bus.ask(keyexprs.camera(CAMERA.hash)) == [codec.encode(CAMERA)]
    assert heads.get(timeout=PATIENCE_S) == LogHead(after.log_id, after.cursor)
    subscription.close()


def test_questions_about_nothing(server: Processes) -> None:
    nobody = keyexprs.keyframe(KeyframeId("a0", SESSION, 12345))
    assert server.bus.ask(nobody) == [b""]
    assert server.bus.ask(keyexprs.camera("0" * 16)) == [b""]
    for nonsense in ("covinz/keyframe/a0/x/y", f"covinz/keyframe/*/{SESSION}/1"):
        assert server.bus.ask(nonsense) == []
    assert server.bus.ask(keyexprs.LOG_RANGE, b"nonsense") == []
    assert server.bus.ask(keyexprs.LOG_RANGE) == []


def test_a_file_that_is_no_log_ends_the_process_with_a_reason(tmp_path: Path) -> None:
    with Processes(tmp_path) as server:
        server.start("router")
        (tmp_path / "data" / "ingest.sqlite").write_bytes(b"not a log" * 1000)
        assert server.spawn("ingest").wait(PATIENCE_S) == 1
        assert "ingest.sqlite as a keyframe log: file is not a database" in server.log_of("ingest")


def test_a_second_ingest_on_the_same_file_ends(server: Processes) -> None:
    assert server.spawn("ingest").wait(PATIENCE_S) == 1
    assert "in use by another process" in server.log_of("ingest")


def test_ingest_ends_with_zero_when_asked(tmp_path: Path) -> None:
    with Processes(tmp_path) as server:
        server.start("router", "ingest")
        assert server.stop("ingest") == 0
