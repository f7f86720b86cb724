"""The connection to the router, for the log: why it is not there, and when it is back."""
# Parts of Zenoh's own type hints lack a return type.
# mypy: untyped-calls-exclude=zenoh

from __future__ import annotations

import logging
import queue

import zenoh

from covinz.bus.diagnosis import why_not
from covinz.config import BusConfig

logger = logging.getLogger(__name__)

# A router that starts anew, e.g. since its roster changed, is back sooner. [s]
_PATIENCE_S = 5.0


class LinkReport:
    """Says in the log when a session has lost its router for long, why, and when it is back."""

    def __init__(self, config: BusConfig) -> None:
        self._config = config
        self.is_there = False  # the router, as far as is known
        self._changes: queue.SimpleQueue[bool | None] = queue.SimpleQueue()

    def follow(self, session: zenoh.Session) -> None:
        """Report until `end`; `session` is connected."""

        def changed(event: zenoh.TransportEvent) -> None:
            self._changes.put(event.kind == zenoh.SampleKind.PUT)

        # Held until the end: it stops with its last reference.
        listener = session.info.declare_transport_events_listener(
            zenoh.handlers.Callback(changed, indirect=False)
        )
        is_there, said = True, False
        self.is_there = True
        while True:
            try:
                change = self._changes.get(timeout=None if is_there or said else _PATIENCE_S)
            except queue.Empty:
                self.say_missing()
                said = True
                continue
            if change is None:
                del listener
                return
            self.is_there = is_there = change
            if is_there and said:
                logger.warning("connected to %s again", self._config.endpoint)
                said = False

    def say_missing(self) -> None:
        """Say why there is no connection; may take seconds."""
        reason = why_not(self._config)
        logger.warning("no way to the router at %s, trying on: %s", self._config.endpoint, reason)

    def end(self) -> None:
        """Let `follow` return."""
        self._changes.put(None)
