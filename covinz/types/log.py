"""The keyframe log as its readers see it."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from covinz.types.keyframe import Gap, Keyframe


class LogView(enum.Enum):
    """How much of a keyframe a reader of the log is sent."""

    POSE = "pose"
    FULL = "full"


@dataclass(frozen=True, slots=True)
class LogRange:
    """Asks ingest for log entries from `start` on; the answer is one LogPage of bounded size."""

    start: int
    view: LogView


@dataclass(frozen=True, slots=True, eq=False)
class LogEntry:
    """One row of the keyframe log: a keyframe or a declared gap."""

    log_index: int
    item: Keyframe | Gap


@dataclass(frozen=True, slots=True, eq=False)
class LogPage:
    """A run of consecutive log entries.

    Attributes:
        log_id: ULID of the log; another one means another history: rebuild.
        head: Number of entries in the log, i.e. the next log_index to be given.
        entries: Consecutive entries from the asked index on; empty at the head.
    """

    log_id: str
    head: int
    entries: tuple[LogEntry, ...]


@dataclass(frozen=True, slots=True)
class LogHead:
    """Wake-up call of ingest: the log has grown to `head` entries."""

    log_id: str
    head: int
