"""The keyframe log: LogRange, LogPage, LogHead. A page carries stored messages as they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from covinz.codec import values
from covinz.codec.reader import Fields, MalformedMessage
from covinz.types import Gap, Keyframe, LogEntry, LogHead, LogPage, LogRange, LogView

_WIRE_VIEW: Final = {LogView.POSE: "Pose", LogView.FULL: "Full"}
_VIEW_OF_WIRE: Final = {name: view for view, name in _WIRE_VIEW.items()}


def log_range_fields(wanted: LogRange) -> Fields:
    """Fields of a LogRange."""
    return {
        "start": values.whole(wanted.start, "start"),
        "view": _WIRE_VIEW[wanted.view],
        "log_id": values.maybe_log_id(wanted.log_id),
        "chain": values.maybe_chain(wanted.chain),
    }


def log_range(fields: Fields) -> LogRange:
    """The inverse of `log_range_fields`."""
    if fields["view"] is None:
        raise ValueError("view is missing")
    return LogRange(
        values.whole(fields["start"], "start"),
        _VIEW_OF_WIRE[fields["view"]],
        values.maybe_log_id(fields["log_id"]) or "",
        values.maybe_chain(fields["chain"]) or "",
    )


def log_head_fields(head: LogHead) -> Fields:
    """Fields of a LogHead."""
    return {"log_id": values.ulid(head.log_id, "log_id"), "head": values.whole(head.head, "head")}


def log_head(fields: Fields) -> LogHead:
    """The inverse of `log_head_fields`."""
    return LogHead(values.ulid(fields["log_id"], "log_id"), values.whole(fields["head"], "head"))


def log_page_fields(
    log_id: str, head: int, entries: Sequence[tuple[int, bytes]], chain: str
) -> Fields:
    """Fields of a LogPage of (log_index, encoded keyframe or gap) in consecutive order."""
    first = entries[0][0] if entries else None
    for position, (log_index, _) in enumerate(entries):
        if first is None or log_index != first + position:
            raise ValueError(f"log_index {log_index} does not follow the one before")
    ends = np.cumsum([len(payload) for _, payload in entries], dtype=np.uint32)
    return {
        "log_id": values.ulid(log_id, "log_id"),
        "head": values.whole(head, "head", low=first + len(entries) if first is not None else 0),
        "first": None if first is None else values.whole(first, "first"),
        "ends": ends,
        "messages": b"".join(payload for _, payload in entries),
        "chain": values.maybe_chain(chain),
    }


def log_page(fields: Fields, decode_entry: Callable[[bytes], Keyframe | Gap]) -> LogPage:
    """The inverse of `log_page_fields`; `decode_entry` turns one message into its value."""
    ends, messages = fields["ends"].astype(np.int64), fields["messages"].tobytes()
    starts = np.concatenate([[0], ends[:-1]]) if len(ends) else ends
    if np.any(ends <= starts) or (int(ends[-1]) if len(ends) else 0) != len(messages):
        raise ValueError("ends: do not divide the messages")
    if (fields["first"] is None) != (len(ends) == 0):
        raise ValueError("first: there exactly when there are entries")
    first = values.whole(fields["first"] or 0, "first")
    spans = zip(starts.tolist(), ends.tolist(), strict=True)
    return LogPage(
        log_id=values.ulid(fields["log_id"], "log_id"),
        head=values.whole(fields["head"], "head", low=first + len(ends)),
        entries=tuple(
            _entry(first + position, messages[start:end], decode_entry)
            for position, (start, end) in enumerate(spans)
        ),
        chain=values.maybe_chain(fields["chain"]) or "",
    )


def _entry(
    log_index: int, message: bytes, decode_entry: Callable[[bytes], Keyframe | Gap]
) -> LogEntry:
    try:
        return LogEntry(log_index, decode_entry(message))
    except ValueError as error:
        raise MalformedMessage(f"entry {log_index}: {error}") from error
