"""The only bridge between the values of `covinz.types` and the bytes of the wire.

Every message is a FlatBuffers message with its own file identifier (schemas/README.md). What is
encoded is checked as strictly as what is decoded; the same value always gives the same bytes, and
``encode(decode(payload)) == payload`` for every payload that `encode` made.

Source: schemas/README.md; docs/conventions.md; decision 0005.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeVar, cast

from covinz import types
from covinz.codec import jobs, log, maps, status, uploads
from covinz.codec.layout import IDENTIFIERS
from covinz.codec.reader import Fields, MalformedMessage, message_name, read
from covinz.codec.writer import write
from covinz.types import Gap, Keyframe, LogPage, Outcome, UploadReply

__all__ = [
    "MalformedMessage",
    "decode",
    "decode_outcome",
    "decode_upload",
    "decode_upload_reply",
    "encode",
    "encode_log_page",
    "says_it_is",
    "schema_name",
    "without_features",
]

T = TypeVar("T")
U = TypeVar("U")

# What reading hostile bytes might raise; `decode` turns all of it into MalformedMessage.
_FAILURES = (ArithmeticError, LookupError, TypeError, ValueError, struct.error)


@dataclasses.dataclass(frozen=True, slots=True)
class _Form:
    """How one message is written to fields and read from them."""

    name: str
    fields: Callable[[Any], Fields]
    value: Callable[[Fields], Any]


def _page_fields(page: LogPage) -> Fields:
    entries = [(entry.log_index, encode(entry.item)) for entry in page.entries]
    return log.log_page_fields(page.log_id, page.head, entries, page.chain)


def _page(fields: Fields) -> LogPage:
    return log.log_page(fields, decode_upload)


_FORMS: Final[dict[type, _Form]] = {
    types.Camera: _Form("Camera", uploads.camera_fields, uploads.camera),
    types.Keyframe: _Form("Keyframe", uploads.keyframe_fields, uploads.keyframe),
    types.Gap: _Form("Gap", uploads.gap_fields, uploads.gap),
    types.LogRange: _Form("LogRange", log.log_range_fields, log.log_range),
    types.LogPage: _Form("LogPage", _page_fields, _page),
    types.LogHead: _Form("LogHead", log.log_head_fields, log.log_head),
    types.LeaseRequest: _Form("LeaseRequest", jobs.lease_request_fields, jobs.lease_request),
    types.Lease: _Form("Lease", jobs.lease_fields, jobs.lease),
    types.LoopJob: _Form("LoopJob", jobs.loop_job_fields, jobs.loop_job),
    types.LoopClosure: _Form("LoopClosure", jobs.loop_closure_fields, jobs.loop_closure),
    types.Rejection: _Form("Rejection", jobs.rejection_fields, jobs.rejection),
    types.JobDone: _Form("JobDone", jobs.job_done_fields, jobs.job_done),
    types.JobRange: _Form("JobRange", jobs.job_range_fields, jobs.job_range),
    types.JobPage: _Form("JobPage", jobs.job_page_fields, jobs.job_page),
    types.LoopRange: _Form("LoopRange", jobs.loop_range_fields, jobs.loop_range),
    types.LoopPage: _Form("LoopPage", jobs.loop_page_fields, jobs.loop_page),
    types.Correction: _Form("Correction", maps.correction_fields, maps.correction),
    types.MapList: _Form("MapList", maps.map_list_fields, maps.map_list),
    types.MapSnapshot: _Form("MapSnapshot", maps.map_snapshot_fields, maps.map_snapshot),
    types.Status: _Form("Status", status.status_fields, status.status),
}
_REPLY = _Form("UploadReply", uploads.upload_reply_fields, uploads.upload_reply)
_REPLIES = (types.Stored, types.Duplicate, types.RetryAfter, types.NeedCamera, types.Rejected)
_FORMS.update(dict.fromkeys(_REPLIES, _REPLY))


def encode(message: object) -> bytes:
    """Write a message; the inverse of `decode`.

    Keypoints are rounded to 1/16 px, and rotations (but a camera's) to about 6e-14 rad; of an
    information matrix the upper triangle counts; everything else is exact.

    Raises:
        ValueError: If a value is not one that `decode` accepts.
        TypeError: If `message` is no message of `covinz.types`.
    """
    form = _FORMS.get(type(message))
    if form is None:
        raise TypeError(f"{type(message).__name__} is not a message")
    return write(form.name, form.fields(message))


def decode(payload: bytes, kind: type[T]) -> T:
    """Read a message of one type, e.g. ``decode(payload, Keyframe)``.

    Raises:
        MalformedMessage: If the payload is not such a message, for whatever reason.
    """
    return cast(T, _decode(payload, _FORMS[kind]))


def decode_upload(payload: bytes) -> Keyframe | Gap:
    """Read what an agent uploads, by its file identifier; raises MalformedMessage."""
    return _one_of(payload, Keyframe, Gap)


def decode_outcome(payload: bytes) -> Outcome:
    """Read the outcome of a job, by its file identifier; raises MalformedMessage."""
    return _one_of(payload, types.LoopClosure, types.Rejection)


def decode_upload_reply(payload: bytes) -> UploadReply:
    """Read ingest's answer to an upload; raises MalformedMessage."""
    return cast(UploadReply, _decode(payload, _REPLY))


def says_it_is(payload: bytes, kind: type) -> bool:
    """Whether a payload has the identifier of a message type; it may be malformed all the same."""
    return payload[4:8] == IDENTIFIERS[_FORMS[kind].name]


def encode_log_page(
    log_id: str, head: int, entries: Sequence[tuple[int, bytes]], chain: str = ""
) -> bytes:
    """Write a LogPage around keyframes and gaps that are encoded already.

    Args:
        log_id: ULID of the log.
        head: Number of entries in the log.
        entries: (log_index, encoded message), consecutive; the messages are taken as they are.
        chain: Hash over the log up to the last entry; empty when unknown.

    Raises:
        ValueError: If the indices are not consecutive or beyond the head.
    """
    return write("LogPage", log.log_page_fields(log_id, head, entries, chain))


def schema_name(payload: bytes) -> str:
    """Name and major version of a message's schema, e.g. ``covinz.Keyframe/1``.

    Raises:
        MalformedMessage: If the payload has no covinz file identifier.
    """
    name = message_name(payload)
    return f"covinz.{name}/{IDENTIFIERS[name][3:].decode()}"


def without_features(kf: Keyframe) -> Keyframe:
    """The keyframe as the log's ``pose`` view shows it: no features, no thumbnail."""
    return dataclasses.replace(kf, features=None, thumbnail_jpeg=None, more_features=())


def _one_of(payload: bytes, first: type[T], second: type[U]) -> T | U:
    name = message_name(payload)
    if _FORMS[first].name == name:
        return decode(payload, first)
    if _FORMS[second].name == name:
        return decode(payload, second)
    raise MalformedMessage(f"expected a {first.__name__} or {second.__name__}, got a {name}")


def _decode(payload: bytes, form: _Form) -> Any:
    try:
        return form.value(read(payload, form.name))
    except MalformedMessage:
        raise
    except _FAILURES as error:
        raise MalformedMessage(f"{form.name}: {error}") from error
