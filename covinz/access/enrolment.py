"""Changes of a roster: members come and go, their credentials are made here and nowhere kept."""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from secrets import token_hex

from covinz.access import certificates, credentials
from covinz.access.credentials import Credentials, Role, dump, write_secret
from covinz.access.roster import (
    DEFAULT_PORT,
    SERVER,
    Identity,
    Member,
    Roster,
    RosterError,
    RosterFile,
    bracketed,
    read_identity,
)
from covinz.access.rules import common_name
from covinz.types import AGENT_PATTERN

# Of a robot's certificate.
LIFETIME = timedelta(days=730)
# Of the server's own certificates; they lie next to the key that could renew them.
SERVER_LIFETIME = timedelta(days=3650)
_LOOPBACK = "127.0.0.1"
# Names under which the server is reached from its own machine or Compose network.
LOCAL_HOSTS = ("localhost", _LOOPBACK, "::1", "router")
_HOST_NAME = re.compile(r"(?=.{1,253}$)[A-Za-z0-9-]{1,63}(\.[A-Za-z0-9-]{1,63})*")
_HEADER = (
    "# Who may connect to this covinz server. `covinz roster add|remove|list` keeps it;\n"
    "# the router follows within a second.\n"
)


@dataclass(frozen=True, slots=True)
class Request:
    """Whom to let in.

    Attributes:
        name: Agent id of the robot, or a name for a person or a further machine of the server.
        role: What it may do.
        host: Where it reaches the server; None: the first known host.
        port: The server's port; None: as before.
        transport: ``tls`` or ``quic``.
        lifetime: Of its certificate.
        replace: Whether the name may be taken: what it had is void then.
    """

    name: str
    role: Role = "agent"
    host: str | None = None
    port: int | None = None
    transport: str = "tls"
    lifetime: timedelta = LIFETIME
    replace: bool = False


def add(roster: Roster, wanted: Request) -> Credentials:
    """Let a member in and return its credentials, of which nothing secret is kept.

    The first one makes the roster: authority, router, and credentials of the server itself.

    Raises:
        RosterError: If the name is malformed or taken, nobody said where the server is, or the
            roster cannot be used.
    """
    name = wanted.name
    if not AGENT_PATTERN.fullmatch(name) or name == SERVER:
        raise RosterError(f"{name!r} cannot be a name: [a-z0-9][a-z0-9_-]{{0,31}}, not {SERVER}")
    if wanted.host is not None and not _is_host(wanted.host):
        raise RosterError(f"{wanted.host!r} is no host name or IP address")
    with _changing(roster) as content:
        if name in content.members and not wanted.replace:
            raise RosterError(
                f"{name} is in the roster already; --replace makes new credentials and the old "
                "ones void"
            )
        if not (wanted.host or content.hosts):
            raise RosterError("say where robots reach this server: --server HOST")
        if not content.members:
            content = _found(roster)
        content = _reachable(roster, content, wanted.host, wanted.port)
        endpoint = f"{wanted.transport}/{bracketed(wanted.host or content.hosts[0])}:{content.port}"
        content, made = _member(roster, content, name, wanted.role, endpoint, wanted.lifetime)
        _write(roster, content)
    return made


def remove(roster: Roster, name: str) -> None:
    """Let a member in no longer; raises RosterError when it is not there."""
    with _changing(roster) as content:
        known = set(content.members) - {SERVER}
        if name not in known:
            raise RosterError(
                f"{name} is not in the roster: {', '.join(sorted(known)) or 'nobody'}"
            )
        left = {other: entry for other, entry in content.members.items() if other != name}
        _write(roster, content.model_copy(update={"members": left}))


def _member(
    roster: Roster,
    content: RosterFile,
    name: str,
    role: Role,
    endpoint: str,
    lifetime: timedelta,
) -> tuple[RosterFile, Credentials]:
    until = (datetime.now(UTC) + lifetime).replace(microsecond=0)
    # This authority's key is dropped here: nobody can ever sign for this member again. It has a
    # name of its own, so that a replaced one is unknown and not a forgery.
    authority = certificates.new_authority(f"covinz roster {name} {token_hex(4)}", until)
    identity = certificates.client_identity(authority, common_name(role, name), until)
    member = Member(role=role, until=until, authority=authority.certificate_pem)
    made = Credentials(
        name=name,
        role=role,
        endpoint=endpoint,
        until=until,
        authority=read_identity(roster.authority).certificate_pem,
        certificate=identity.certificate_pem,
        key=identity.key_pem,
    )
    return content.model_copy(update={"members": {**content.members, name: member}}), made


def _found(roster: Roster) -> RosterFile:
    """Make authority, router and server; the roster itself is written by who adds to it."""
    until = (datetime.now(UTC) + SERVER_LIFETIME).replace(microsecond=0)
    authority = certificates.new_authority(f"covinz server {token_hex(4)}", until)
    write_secret(roster.authority, authority.certificate_pem + authority.key_pem)
    _sign_router(roster, ())
    content, own = _member(roster, RosterFile(), SERVER, "server", "", SERVER_LIFETIME)
    _write_server(roster, own, DEFAULT_PORT)
    return content


def _reachable(
    roster: Roster, content: RosterFile, host: str | None, port: int | None
) -> RosterFile:
    """`content` with a host and port; a new host is written into the router's certificate."""
    hosts = tuple(dict.fromkeys((*content.hosts, *([host] if host else []))))
    if set(hosts) - set(content.hosts) - set(LOCAL_HOSTS):
        _sign_router(roster, hosts)
    if port is not None and port != content.port:
        _write_server(roster, credentials.read(roster.server_credentials), port)
    return content.model_copy(update={"hosts": hosts, "port": port or content.port})


def _sign_router(roster: Roster, hosts: tuple[str, ...]) -> None:
    authority = read_identity(roster.authority)
    names = tuple(dict.fromkeys((*LOCAL_HOSTS, *hosts)))
    try:
        until = certificates.until(authority.certificate_pem)
        router: Identity = certificates.router_identity(authority, names, until)
    except certificates.CertificateError as error:
        raise RosterError(str(error)) from error
    write_secret(roster.router, router.certificate_pem + router.key_pem)


def _write_server(roster: Roster, own: Credentials, port: int) -> None:
    moved = own.model_copy(update={"endpoint": f"tls/{_LOOPBACK}:{port}"})
    write_secret(roster.server_credentials, moved.text())


def _write(roster: Roster, content: RosterFile) -> None:
    write_secret(roster.file, _HEADER + dump(content.model_dump(mode="json")))


def _is_host(text: str) -> bool:
    try:
        ip_address(text)
    except ValueError:
        return _HOST_NAME.fullmatch(text) is not None
    return True


@contextmanager
def _changing(roster: Roster) -> Iterator[RosterFile]:
    """The content, empty when there is none, while nobody else may change it."""
    try:
        roster.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        lock = os.open(roster.folder / ".lock", os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise RosterError(f"cannot use {roster.folder}: {error.strerror}") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield roster.read() if roster.exists() else RosterFile()
    finally:
        os.close(lock)
