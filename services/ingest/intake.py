"""The door of ingest: takes uploads from bus threads into the inbox, or turns them away unread."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from covinz import codec, keyexprs
from covinz.bus import Query
from covinz.config import IngestConfig
from covinz.types import RetryAfter
from services.ingest.admission import Code, rejected


class EventSink(Protocol):
    """A bounded queue of events; `covinz.service.Inbox`."""

    def put(self, event: object, block: bool = True) -> bool:
        """Add an event; False when it is full or stopping."""


@dataclass(frozen=True, slots=True, eq=False)
class Upload:
    """An upload as it came; somebody waits for the answer to `query`."""

    agent: str
    is_camera: bool
    payload: bytes
    query: Query


class Intake:
    """Bounds what waits, in all and per agent, before anything is decoded.

    An agent that sends faster than the log commits is told to retry without taking the places
    of the others. Safe to call from any thread.
    """

    def __init__(self, inbox: EventSink, config: IngestConfig) -> None:
        self._inbox = inbox
        self._config = config
        self._lock = threading.Lock()  # bus threads and the owner thread share what follows
        self._waiting: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()

    def on_keyframe(self, query: Query) -> None:
        """Take an upload of a keyframe or gap."""
        self._take(query, keyexprs.agent_keyframe, is_camera=False)

    def on_camera(self, query: Query) -> None:
        """Take the registration of a calibration."""
        self._take(query, keyexprs.agent_camera, is_camera=True)

    def done(self, upload: Upload) -> None:
        """The upload has been answered and no longer waits."""
        with self._lock:
            self._waiting[upload.agent] -= 1
            if not self._waiting[upload.agent]:
                del self._waiting[upload.agent]

    @property
    def waiting(self) -> int:
        """Uploads that wait for an answer."""
        with self._lock:
            return self._waiting.total()

    @property
    def refused(self) -> Counter[str]:
        """How many were turned away unread, by counter name."""
        with self._lock:
            return self._refused.copy()

    def _take(self, query: Query, key_of: Callable[[str], str], is_camera: bool) -> None:
        try:
            agent = keyexprs.agent_of(query.key)
        except ValueError:
            agent = ""
        if not agent or query.key != key_of(agent):
            return self._reject(query, Code.BAD_KEY, f"uploads do not go to {query.key!r}")
        payload = query.payload
        if len(payload) > self._config.max_upload_bytes:
            limit = self._config.max_upload_bytes
            return self._reject(query, Code.TOO_LARGE, f"{len(payload)} of {limit} bytes")
        if not self._enter(agent):
            return self._defer(query)
        upload = Upload(agent, is_camera, payload, query)
        if not self._inbox.put(upload, block=False):
            self.done(upload)
            self._defer(query)
        return None

    def _enter(self, agent: str) -> bool:
        with self._lock:
            waiting = self._waiting
            own, total = waiting.get(agent, 0), waiting.total()
            if own >= self._config.inbox_per_agent or total >= self._config.inbox:
                return False
            waiting[agent] += 1
            return True

    def _reject(self, query: Query, code: Code, reason: str) -> None:
        with self._lock:
            self._refused[f"rejected.{code.value}"] += 1
        query.reply(codec.encode(rejected(code, reason)))

    def _defer(self, query: Query) -> None:
        with self._lock:
            self._refused["retry_after"] += 1
        answer = RetryAfter(self._config.retry_after_s, "too many uploads wait")
        query.reply(codec.encode(answer))
