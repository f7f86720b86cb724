"""What commands share that ask a running server: their options, and the way there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from covinz import client, config
from covinz.access.credentials import with_credentials
from covinz.bus import Bus, ZenohBus, why_not

Endpoint = Annotated[
    str | None,
    typer.Option(
        help=f"Where the router listens [{config.BusConfig().endpoint}].",
        envvar="COVINZ__BUS__ENDPOINT",
    ),
]
CredentialsFile = Annotated[
    Path | None,
    typer.Option(
        "--credentials",
        help="NAME.covinz of an operator; the server's own is DATA/roster/server.covinz.",
        envvar="COVINZ__BUS__CREDENTIALS",
    ),
]
CONNECT_TIMEOUT_S = 3.0


def bus_config(endpoint: str | None, credentials: Path | None) -> config.BusConfig:
    """How to connect."""
    settings = config.BusConfig()
    if endpoint is not None:
        settings = settings.model_copy(update={"endpoint": endpoint})
    if credentials is not None:
        settings = with_credentials(settings, credentials, endpoint)
    return settings


@contextmanager
def connected(endpoint: str | None, credentials: Path | None) -> Iterator[Bus]:
    """A bus for the block; raises ServerUnavailable when there is no way to the router."""
    settings = bus_config(endpoint, credentials)
    bus = ZenohBus.open(settings)
    try:
        if not bus.wait_connected(CONNECT_TIMEOUT_S):
            raise client.ServerUnavailable(f"no way to {settings.endpoint}: {why_not(settings)}")
        yield bus
    finally:
        bus.close()
