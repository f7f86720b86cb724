"""Endpoints as text, e.g. ``tls/10.8.0.1:7447``: are they encrypted, do they leave the machine?"""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import ip_address

from covinz.bus.protocol import BusError

ENCRYPTED = ("tls", "quic")
# Sockets that are files: nobody reaches them from elsewhere.
_FILES = ("unixsock-stream", "unixpipe")


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One endpoint, taken apart.

    Attributes:
        protocol: Zenoh's name of it, e.g. ``tls``.
        host: Name or address, without brackets; empty for files.
        port: Port; 0 for files.
    """

    protocol: str
    host: str
    port: int

    @property
    def is_encrypted(self) -> bool:
        """Whether both sides prove who they are and nobody else can read."""
        return self.protocol in ENCRYPTED

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches it."""
        if self.protocol in _FILES or self.host == "localhost":
            return True
        try:
            return ip_address(self.host).is_loopback
        except ValueError:
            return False


def parse(text: str) -> Endpoint:
    """Take an endpoint apart; raises BusError when it is malformed."""
    protocol, _, rest = text.partition("/")
    if protocol in _FILES and rest:
        return Endpoint(protocol, "", 0)
    address = rest.partition("?")[0].partition("#")[0]
    host, _, port = address.rpartition(":")
    if not protocol or not host or not port.isdecimal() or int(port) > 65535:
        raise BusError(f"not an endpoint: {text!r}; expected e.g. tcp/127.0.0.1:7447")
    return Endpoint(protocol, host.removeprefix("[").removesuffix("]"), int(port))
