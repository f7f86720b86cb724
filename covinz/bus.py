"""The message bus: what every process needs of Zenoh, and nothing else.

`Bus` is the protocol that the rest of covinz is written against.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Closable(Protocol):
    """A declaration that can be withdrawn."""

    def close(self) -> None:
        """Withdraw it."""


class Query(Protocol):
    """A question that somebody waits for; may be answered later, from any thread, once."""

    @property
    def key(self) -> str:
        """Key expression that was asked."""

    @property
    def payload(self) -> bytes:
        """Body of the question; empty when there is none."""

    def reply(self, payload: bytes) -> None:
        """Answer and end the query."""

    def drop(self) -> None:
        """End the query without an answer; the asker sees an empty result at once."""


class Bus(Protocol):
    """Publish, ask, answer and watch who is alive."""

    def put(self, key: str, payload: bytes) -> None:
        """Publish what may be lost; never blocks."""

    def subscribe(self, key: str, callback: Callable[[str, bytes], None]) -> Closable:
        """Call `callback(key, payload)` for every publication, from a bus thread."""

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        """Query and wait; returns all answers, empty when nobody answered or time ran out."""

    def answer(self, key: str, callback: Callable[[Query], None]) -> Closable:
        """Call `callback(query)` for every question, from a bus thread; it must not block."""

    def declare_alive(self, key: str) -> Closable:
        """Hold a liveliness token until it is closed or this process dies."""

    def watch_alive(self, key: str, callback: Callable[[str, bool], None]) -> Closable:
        """Call `callback(key, alive)` for tokens that are there, appear and vanish."""

    def alive(self, key: str) -> list[str]:
        """Keys of the tokens that exist now."""

    def close(self) -> None:
        """End the session and everything declared on it."""
