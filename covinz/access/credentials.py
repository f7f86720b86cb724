"""The one file that a robot, or a process of the server, needs to be let in: `NAME.covinz`.

A YAML file with the address of the server, the authority that signs for it, and a certificate
with its private key. It is a secret: whoever has it is that member of the roster.
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import yaml

from covinz.config import BusConfig, ConfigError, Section, read_yaml, validate

SUFFIX = ".covinz"
# Which processes a member may be; what they may do is in `covinz.access.rules`.
Role = Literal["agent", "server"]
_HEADER = "# Credentials for a covinz server. Keep it secret: whoever has it is this member.\n"


class CredentialsError(ConfigError):
    """A file of credentials that cannot be used; the message says which, why and what to do."""


class Credentials(Section):
    """What a member of the roster proves itself with, and whom it trusts."""

    # Name in the roster; a robot's agent id.
    name: str
    role: Role
    # Where the server is, e.g. tls/10.8.0.1:7447 or quic/10.8.0.1:7447.
    endpoint: str
    # The certificate expires. [UTC]
    until: datetime
    # Certificate of the server's authority. [PEM]
    authority: str
    certificate: str
    key: str

    @property
    def is_expired(self) -> bool:
        """Whether the server refuses them by now, by this machine's clock."""
        return datetime.now(UTC) >= self.until

    def text(self) -> str:
        """The file."""
        return _HEADER + dump(self.model_dump(mode="json"))


def read(path: Path) -> Credentials:
    """Read a file of credentials.

    Raises:
        CredentialsError: If there is none, or it is damaged.
    """
    try:
        found = validate(Credentials, read_yaml(path), str(path))
    except ConfigError as error:
        raise CredentialsError(
            f"no usable credentials: {error}; `covinz roster add NAME` on the server makes them"
        ) from error
    for name in ("authority", "certificate", "key"):
        if not getattr(found, name).startswith("-----BEGIN "):
            raise CredentialsError(f"{path}: {name} is not PEM")
    if found.until.tzinfo is None:
        raise CredentialsError(f"{path}: until has no time zone")
    return found


def write_secret(path: Path, text: str) -> None:
    """Write a file that only its owner may read, whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        with os.fdopen(descriptor, "w") as file:
            os.fchmod(file.fileno(), 0o600)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def with_credentials(config: BusConfig, path: Path, endpoint: str | None = None) -> BusConfig:
    """The bus of a member: where its credentials say, or at another endpoint of that server.

    Raises:
        CredentialsError: If the file cannot be used.
    """
    found = endpoint or read(path).endpoint
    return config.model_copy(update={"credentials": path, "endpoint": found})


def agent_bus(
    agent_id: str, config: BusConfig, path: Path, endpoint: str | None = None
) -> BusConfig:
    """The bus of a robot: as `with_credentials`, and they are its own and good.

    Raises:
        CredentialsError: If they are another's, of an operator, or have expired.
    """
    own = read(path)
    if (own.role, own.name) != ("agent", agent_id):
        raise CredentialsError(f"{path}: these are the credentials of {own.name}, not {agent_id}")
    if own.is_expired:
        raise CredentialsError(
            f"{path}: these credentials expired on {own.until:%Y-%m-%d}; on the server "
            f"`covinz roster add {own.name} --replace` makes new ones (or this clock is wrong)"
        )
    return with_credentials(config, path, endpoint)


class _Dumper(yaml.SafeDumper):
    """Texts of several lines as they are, not with escaped line ends."""


def _text(dumper: yaml.SafeDumper, value: str) -> yaml.ScalarNode:
    style = "|" if "\n" in value else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=style)


_Dumper.add_representer(str, _text)


def dump(values: object) -> str:
    """YAML with texts of several lines, e.g. PEM, as they are."""
    return yaml.dump(values, Dumper=_Dumper, sort_keys=False)
