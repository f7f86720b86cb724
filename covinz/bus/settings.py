"""Zenoh's configuration, as covinz uses it.

Source: decisions 0002 and 0007; measured with Zenoh 1.10.2.
"""

from __future__ import annotations

import json

import zenoh

from covinz.bus.protocol import BusError
from covinz.config import BusConfig

# A message on the link is this much larger than its payload: key, encoding, headers. [bytes]
_ENVELOPE_BYTES = 4096


def client_settings(config: BusConfig) -> zenoh.Config:
    """Of a session that knows nothing but its router; raises BusError."""
    return _settings(
        config,
        {
            "mode": "client",
            "connect/endpoints": [config.endpoint],
            # One attempt to open (we repeat it ourselves, so that it can be interrupted) ...
            "connect/timeout_ms": 0,
            # ... and soon again, without end, once a connection is lost.
            "connect/retry": {
                "period_init_ms": 100,
                "period_max_ms": 1000,
                "period_increase_factor": 2,
            },
        },
    )


def router_settings(config: BusConfig) -> zenoh.Config:
    """Of the router; raises BusError."""
    size_limit = {
        "id": "size",
        "flows": ["ingress"],
        "messages": ["put", "query", "reply"],
        "key_exprs": ["**"],
        "size_limit": config.max_message_bytes + _ENVELOPE_BYTES,
    }
    return _settings(
        config,
        {
            "mode": "router",
            "listen/endpoints": [config.endpoint],
            "connect/endpoints": [],
            # Nobody is looked for, so nobody is waited for.
            "scouting/delay": 0,
            "low_pass_filter": [size_limit],
        },
    )


def _settings(config: BusConfig, special: dict[str, object]) -> zenoh.Config:
    """Zenoh's configuration: what all sessions share, and what is special to one kind."""
    shared: dict[str, object] = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": config.max_message_bytes + 2 * _ENVELOPE_BYTES,
    }
    settings = zenoh.Config()
    for name, value in (shared | special).items():
        try:
            settings.insert_json5(name, json.dumps(value))
        except zenoh.ZError as error:
            if name.endswith("/endpoints"):
                raise BusError(
                    f"not an endpoint: {config.endpoint!r}; expected e.g. tcp/127.0.0.1:7447"
                ) from error
            raise BusError(f"cannot use {name} = {value}: {error}") from error
    return settings
