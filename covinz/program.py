"""Which program this is: its version, and the one of the messages that it knows."""

from __future__ import annotations

import hashlib

from covinz.wire import layout


def _version() -> str:
    known = f"{layout.MESSAGES} {layout.TABLES} {layout.ENUMS}"
    schemas = hashlib.blake2b(known.encode(), digest_size=4).hexdigest()
    return f"{NUMBER}+messages.{schemas}"


# As in pyproject.toml (a test compares): importlib.metadata does not know a plain checkout.
NUMBER = "0.1.0"
# Two programs with the same text understand every field of one another.
VERSION = _version()
