"""The roster, as the router reads it: who may connect to a server. `enrolment` changes it.

A folder, all files for their owner only:

- `roster.yaml`: the members, with their authorities' certificates; hosts and port of the server.
- `authority.pem`: the server's authority, which signs the router's certificate; a secret.
- `router.pem`: what the router listens with; a secret.
- `server.covinz`: credentials of the server's own processes; a secret.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

from pydantic import Field

from covinz.access.credentials import SUFFIX, Role
from covinz.config import ConfigError, Section, read_yaml, validate

FOLDER = "roster"
# The member that the server's own processes are.
SERVER = "server"
DEFAULT_PORT = 7447
_PEM = re.compile(r"-----BEGIN ([A-Z ]+)-----\n.*?-----END \1-----\n", re.DOTALL)


class RosterError(ConfigError):
    """A roster that cannot be used or changed so; the message says what to do."""


class Member(Section):
    """One entry of the roster."""

    role: Role
    # Its certificate expires. [UTC]
    until: datetime
    # Certificate of the authority that signed for this member alone. [PEM]
    authority: str


class RosterFile(Section):
    """Content of `roster.yaml`."""

    # Under which hosts robots reach the server; the first is what new robots are given.
    hosts: tuple[str, ...] = ()
    port: Annotated[int, Field(gt=0, lt=65536)] = DEFAULT_PORT
    members: dict[str, Member] = Field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Identity:
    """A certificate and its private key, both PEM; whoever has it can prove to be its subject."""

    certificate_pem: str
    key_pem: str


@dataclass(frozen=True, slots=True)
class RouterAccess:
    """What the router needs of a roster.

    Attributes:
        identity: What it listens with.
        trusted_pem: Certificates of all authorities whose members may connect.
        members: Their roles by name.
    """

    identity: Identity
    trusted_pem: str
    members: Mapping[str, Role]


class Roster:
    """A roster in a folder; it need not exist yet."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / "roster.yaml"
        self.authority = folder / "authority.pem"
        self.router = folder / "router.pem"
        self.server_credentials = folder / f"{SERVER}{SUFFIX}"

    def exists(self) -> bool:
        """Whether anybody was ever added."""
        return self.file.is_file()

    def version(self) -> tuple[int, ...]:
        """Numbers that differ whenever what the router reads does; empty when it is not there."""
        try:
            found = [path.stat() for path in (self.file, self.router)]
        except OSError:
            return ()
        return tuple(n for one in found for n in (one.st_ino, one.st_mtime_ns, one.st_size))

    def read(self) -> RosterFile:
        """Everything in it; raises RosterError when there is none or it is damaged."""
        if not self.exists():
            raise RosterError(
                f"there is no roster in {self.folder}; `covinz roster add NAME --server HOST` "
                "makes it"
            )
        try:
            return validate(RosterFile, read_yaml(self.file), str(self.file))
        except ConfigError as error:
            raise RosterError(str(error)) from error

    def router_access(self) -> RouterAccess:
        """What the router needs; raises RosterError when it cannot be read."""
        content = self.read()
        return RouterAccess(
            identity=read_identity(self.router),
            trusted_pem="".join(member.authority for member in content.members.values()),
            members={name: member.role for name, member in content.members.items()},
        )


def read_identity(path: Path) -> Identity:
    """Read a file with one certificate and its key; raises RosterError."""
    try:
        text = path.read_text()
    except OSError as error:
        raise RosterError(f"cannot read {path}: {error.strerror}") from error
    blocks = {match.group(1): match.group(0) for match in _PEM.finditer(text)}
    if blocks.keys() != {"CERTIFICATE", "PRIVATE KEY"}:
        raise RosterError(f"{path} does not hold one certificate and its key")
    return Identity(blocks["CERTIFICATE"], blocks["PRIVATE KEY"])


def bracketed(host: str) -> str:
    """A host as it stands before a port: IPv6 addresses in brackets."""
    return f"[{host}]" if ":" in host else host
