"""How far a process is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Status:
    """What a process answers when asked how far it is.

    The system is idle when every cursor is at the head of the log, no job is pending or leased
    and nothing is dirty.

    Attributes:
        service: Name of the process, e.g. ``ingest``.
        instance: Which one of several.
        log_id: Log it follows or owns; empty when it has none.
        cursor: Next log index it will process (for ingest: the head of the log).
        pending: Jobs or events that wait.
        leased: Jobs lent out.
        dirty: Something accepted is not yet reflected in what the process publishes.
        counters: Further numbers by name.
        version: `covinz.program.VERSION` of the process; empty: unknown.
        now_ns: Its clock when it answered, since the Unix epoch; None: unknown.
    """

    service: str
    instance: str
    log_id: str
    cursor: int
    pending: int
    leased: int
    dirty: bool
    counters: Mapping[str, float] = field(default_factory=dict)
    version: str = ""
    now_ns: int | None = None
