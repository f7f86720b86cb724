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
    """Asks ingest for log entries from `start` on; the answer is one LogPage of bounded size.

    Attributes:
        start: First log_index wanted.
        view: How much of each entry.
        log_id: Log that was followed so far; empty when none.
        chain: `LogPage.chain` of what came before `start`; empty when nothing did.
    """

    start: int
    view: LogView
    log_id: str = ""
    chain: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class LogEntry:
    """One row of the keyframe log: a keyframe or a declared gap."""

    log_index: int
    item: Keyframe | Gap


@dataclass(frozen=True, slots=True)
class LogMark:
    """How much of which log a consumer has seen.

    Attributes:
        log_id: The log; empty when none.
        index: Number of entries seen.
        chain: Hash over them: `LogPage.chain`.
    """

    log_id: str = ""
    index: int = 0
    chain: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class LogPage:
    """A run of consecutive log entries.

    Attributes:
        log_id: ULID of the log; another one means another history: rebuild.
        head: Number of entries in the log, i.e. the next log_index to be given.
        entries: Consecutive entries from the asked index on; empty at the head.
        chain: Hash over the whole log up to the last entry here (without one: up to the asked
            index); empty when unknown. Equal chains mean equal histories.
    """

    log_id: str
    head: int
    entries: tuple[LogEntry, ...]
    chain: str = ""

    @property
    def mark(self) -> LogMark:
        """What a consumer has seen of the log with the last entry of this page, if it has one."""
        return LogMark(self.log_id, self.entries[-1].log_index + 1, self.chain)


@dataclass(frozen=True, slots=True)
class LogHead:
    """Wake-up call of ingest: the log has grown to `head` entries."""

    log_id: str
    head: int
