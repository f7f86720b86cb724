"""Zenoh's configuration, as covinz uses it.

Source: decisions 0002, 0007 and 0024; measured with Zenoh 1.10.2.
"""

from __future__ import annotations

import json
from base64 import b64encode

import zenoh

from covinz.access import credentials
from covinz.access.credentials import CredentialsError
from covinz.access.roster import Roster, RosterError
from covinz.access.rules import access_control
from covinz.bus import endpoints
from covinz.bus.protocol import BusError
from covinz.config import BusConfig

# A message on the link is this much larger than its payload: key, encoding, headers. [bytes]
_ENVELOPE_BYTES = 4096
_TLS = "transport/link/tls"
# What a client may have under way fits into its socket. Of a link that is dead while a write to it
# waits for room, Zenoh takes leave only when that write ends, which TCP's own repetitions make up
# to half a minute. Linux cuts it to net.core.wmem_max. [bytes]
_SEND_BUFFER_BYTES = 1 << 20


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
            "transport/link/tcp/so_sndbuf": _SEND_BUFFER_BYTES,
            f"{_TLS}/so_sndbuf": _SEND_BUFFER_BYTES,
            **_client_tls(config),
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
            "listen/endpoints": listening(config),
            "connect/endpoints": [],
            # Nobody is looked for, so nobody is waited for.
            "scouting/delay": 0,
            "low_pass_filter": [size_limit],
            **_router_access(config),
        },
    )


def listening(config: BusConfig) -> list[str]:
    """Where the router listens; raises BusError when it must not."""
    found = list(config.listen) or [config.endpoint]
    for text in found:
        endpoint = endpoints.parse(text)
        if endpoint.is_encrypted and config.roster is None:
            raise BusError(
                f"cannot listen on {text} without a roster of who may connect: make one with "
                "`covinz roster add NAME --server HOST`"
            )
        if not (endpoint.is_encrypted or endpoint.is_local or config.insecure):
            raise BusError(
                f"{text} would be open to other machines without encryption or access control. "
                "Let robots in with `covinz roster add NAME --server HOST` and "
                "`covinz up --listen ADDRESS`; or set bus.insecure where nobody else is on the "
                "network"
            )
    return found


def _client_tls(config: BusConfig) -> dict[str, object]:
    if config.credentials is None:
        if endpoints.parse(config.endpoint).is_encrypted:
            raise BusError(
                f"{config.endpoint} needs credentials: the file NAME.covinz that `covinz roster "
                "add NAME` wrote on the server"
            )
        return {}
    try:
        own = credentials.read(config.credentials)
    except CredentialsError as error:
        raise BusError(str(error)) from error
    return {
        f"{_TLS}/root_ca_certificate_base64": _base64(own.authority),
        f"{_TLS}/connect_certificate_base64": _base64(own.certificate),
        f"{_TLS}/connect_private_key_base64": _base64(own.key),
        f"{_TLS}/enable_mtls": True,
        f"{_TLS}/close_link_on_expiration": True,
    }


def _router_access(config: BusConfig) -> dict[str, object]:
    if config.roster is None:
        return {}
    try:
        access = Roster(config.roster).router_access()
    except RosterError as error:
        raise BusError(str(error)) from error
    return {
        f"{_TLS}/root_ca_certificate_base64": _base64(access.trusted_pem),
        f"{_TLS}/listen_certificate_base64": _base64(access.identity.certificate_pem),
        f"{_TLS}/listen_private_key_base64": _base64(access.identity.key_pem),
        f"{_TLS}/enable_mtls": True,
        f"{_TLS}/close_link_on_expiration": True,
        "access_control": access_control(access.members.items()),
    }


def _base64(text: str) -> str:
    return b64encode(text.encode()).decode()


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
                    f"not an endpoint: {value}; expected e.g. tcp/127.0.0.1:7447"
                ) from error
            shown = "..." if name.startswith(_TLS) else value
            raise BusError(f"cannot use {name} = {shown}: {error}") from error
    return settings
