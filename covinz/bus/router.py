"""The hub in the middle: a Zenoh router in threads of this process."""
# Parts of Zenoh's own type hints lack a return type.
# mypy: untyped-calls-exclude=zenoh

from __future__ import annotations

import re

import zenoh

from covinz.bus.protocol import BusError, Closable
from covinz.bus.settings import router_settings
from covinz.config import BusConfig


def open_router(config: BusConfig) -> Closable:
    """Run the hub that all sessions connect to, in threads of this process.

    Raises:
        BusError: If the endpoint is malformed or somebody listens there already.
    """
    try:
        return _Router(zenoh.open(router_settings(config)))
    except zenoh.ZError as error:
        # Without the places in Zenoh's source.
        reason = re.sub(r" at \S+\.rs:\d+\.?", "", str(error))
        raise BusError(f"cannot listen on {config.endpoint}: {reason}") from error


class _Router:
    """The hub while it runs."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    def close(self) -> None:
        """Stop; all sessions lose their connection and wait for the next router."""
        self._session.close()
