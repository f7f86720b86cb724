"""The hub in the middle: a Zenoh router in threads of this process."""
# Parts of Zenoh's own type hints lack a return type.
# mypy: untyped-calls-exclude=zenoh

from __future__ import annotations

import re
import time

import zenoh

from covinz.bus.protocol import BusError
from covinz.bus.settings import listening, router_settings
from covinz.config import BusConfig

# A port that was just closed is free again soon; QUIC's took 0.1 s. [s]
_REOPEN_S = 10.0
_RETRY_S = 0.02


def open_router(config: BusConfig) -> Router:
    """Run the hub that all sessions connect to, in threads of this process.

    Raises:
        BusError: If an endpoint is malformed, open to others without encryption, or somebody
            listens there already; or the roster cannot be used.
    """
    # Zenoh says whom it turned away, and why, where RUST_LOG asks for it.
    zenoh.try_init_log_from_env()
    return Router(config, _open(config, router_settings(config)))


class Router:
    """The hub while it runs."""

    def __init__(self, config: BusConfig, session: zenoh.Session) -> None:
        self._config = config
        self._session = session

    def reopen(self) -> None:
        """Read the roster again and start anew with it; sessions reconnect if they still may.

        Zenoh 1.10 cannot change its access control while it runs.

        Raises:
            BusError: If the roster cannot be used; then nothing has changed. Or if the port was
                taken by somebody else meanwhile; then the hub is closed.
        """
        settings = router_settings(self._config)
        self._session.close()
        deadline = time.monotonic() + _REOPEN_S
        while True:
            try:
                self._session = _open(self._config, settings)
                return
            except BusError:
                if time.monotonic() > deadline:
                    raise
            time.sleep(_RETRY_S)

    @property
    def is_open(self) -> bool:
        """Whether it runs."""
        return not self._session.is_closed()

    def close(self) -> None:
        """Stop; all sessions lose their connection and wait for the next router."""
        self._session.close()


def _open(config: BusConfig, settings: zenoh.Config) -> zenoh.Session:
    try:
        return zenoh.open(settings)
    except zenoh.ZError as error:
        # Without the places in Zenoh's source.
        reason = re.sub(r" at \S+\.rs:\d+\.?", "", str(error))
        raise BusError(f"cannot listen on {', '.join(listening(config))}: {reason}") from error
