"""Which program this is: its version, the one of the messages that it knows, its name."""

from __future__ import annotations

import hashlib
import socket

from covinz.wire import layout


def _version() -> str:
    known = f"{layout.MESSAGES} {layout.TABLES} {layout.ENUMS}"
    schemas = hashlib.blake2b(known.encode(), digest_size=4).hexdigest()
    return f"{NUMBER}+messages.{schemas}"


# As in pyproject.toml (a test compares): importlib.metadata does not know a plain checkout.
NUMBER = "0.1.0"
# Two programs with the same text understand every field of one another.
VERSION = _version()


def instance_name(text: str) -> str:
    """The name of a process: ``{host}`` stands for this machine's, or container's, own name."""
    return text.replace("{host}", socket.gethostname())
