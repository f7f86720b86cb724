"""What reads messages of strangers: the very functions that the services call.

Each takes any bytes and either returns a value or raises MalformedMessage. Admission returns its
verdict instead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from covinz import codec, types
from covinz.codec.layout import IDENTIFIERS
from covinz.config import IngestConfig
from services.ingest.admission import AdmittedCamera, AdmittedUpload, admit_camera, admit_upload
from tests.contract.examples import EXAMPLES, QUERY

Reader = Callable[[bytes], Any]

_LIMITS: Final = IngestConfig()
_CAMERA: Final[types.Camera] = EXAMPLES["Camera"]
# A calibration under the name that the example keyframes give it.
_CAMERAS: Final = {EXAMPLES["Keyframe"].camera_hash: _CAMERA}


def _decoder(kind: type[Any]) -> Reader:
    return lambda payload: codec.decode(payload, kind)


def _admit_upload(payload: bytes) -> types.Keyframe | types.Gap | types.UploadReply:
    verdict = admit_upload(QUERY.agent, payload, _CAMERAS, _LIMITS)
    if isinstance(verdict, AdmittedUpload):
        pose = codec.decode_upload(verdict.pose)
        assert type(pose) is type(verdict.item)
        return verdict.item
    codec.encode(verdict)  # the agent is told
    return verdict


def _admit_camera(payload: bytes) -> types.Camera | types.UploadReply:
    verdict = admit_camera(QUERY.agent, payload)
    if isinstance(verdict, AdmittedCamera):
        assert len(verdict.camera.hash) == 16
        return verdict.camera
    codec.encode(verdict)
    return verdict


def _readers() -> dict[str, tuple[Reader, ...]]:
    found: dict[str, tuple[Reader, ...]] = {}
    for name in IDENTIFIERS:
        kind = getattr(types, name, None)
        if isinstance(kind, type):
            found[name] = (_decoder(kind),)
    found["UploadReply"] = (codec.decode_upload_reply,)
    for name in ("Keyframe", "Gap"):
        found[name] += (codec.decode_upload, _admit_upload)
    for name in ("LoopClosure", "Rejection"):
        found[name] += (codec.decode_outcome,)
    found["Camera"] += (_admit_camera,)
    assert found.keys() == IDENTIFIERS.keys()
    return found


# By the name of the message that they expect.
READERS: Final[Mapping[str, tuple[Reader, ...]]] = _readers()


def send_on(value: Any) -> None:
    """A value that was accepted can be sent on, and arrives as it is.

    Raises:
        AssertionError: If it changes on its way.
        ValueError: If it cannot be sent, or not be read.
    """
    payload = codec.encode(value)
    is_reply = isinstance(value, types.UploadReply)
    kind = type(value)
    again = codec.decode_upload_reply(payload) if is_reply else codec.decode(payload, kind)
    assert codec.encode(again) == payload
