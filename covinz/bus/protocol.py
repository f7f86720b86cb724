"""What the rest of covinz knows of the bus: protocols and errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class BusError(RuntimeError):
    """The bus cannot be used as it is configured, e.g. a malformed or occupied endpoint."""


class BusClosed(RuntimeError):
    """The bus was closed or interrupted: there are no answers any more."""


class MessageTooLarge(ValueError):
    """A payload beyond `BusConfig.max_message_bytes`; the router would drop it silently."""


class Closable(Protocol):
    """A declaration that can be withdrawn."""

    def close(self) -> None:
        """Withdraw it; once closed, closing again does nothing."""


class Query(Protocol):
    """A question that somebody waits for; may be answered later, from any thread, once."""

    @property
    def key(self) -> str:
        """Key expression that was asked."""

    @property
    def payload(self) -> bytes:
        """Body of the question; empty when there is none."""

    def reply(self, payload: bytes) -> None:
        """Answer and end the query; nothing happens when it has ended or the asker is gone.

        Raises:
            MessageTooLarge: If the answer does not fit on the bus; the query is dropped.
        """

    def drop(self) -> None:
        """End the query without an answer; nothing happens when it has ended."""


class Bus(Protocol):
    """Publish, ask, answer and watch who is alive.

    A callback runs in a thread of the bus, never twice at once for one declaration. It must not
    block. What it raises is logged, and a query it was given is dropped then.
    """

    def put(self, key: str, payload: bytes) -> None:
        """Publish what may be lost; never blocks.

        Raises:
            MessageTooLarge: If the payload does not fit on the bus.
        """

    def subscribe(self, key: str, callback: Callable[[str, bytes], None]) -> Closable:
        """Call `callback(key, payload)` for every publication, from a bus thread."""

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        """Query everybody who answers `key` and wait until all have replied or dropped it.

        Returns:
            The replies in order of arrival; empty at once when nobody answers `key` or the router
            is away (so pause before you ask again), and those so far when time ran out.

        Raises:
            MessageTooLarge: If the payload does not fit on the bus.
            BusClosed: If the bus was closed or interrupted, also during the wait.
        """

    def answer(self, key: str, callback: Callable[[Query], None]) -> Closable:
        """Call `callback(query)` for every question, from a bus thread; it must not block.

        Every query must be replied to or dropped, or its asker waits until its time is up.
        """

    def watch_answered(self, key: str, callback: Callable[[bool], None]) -> Closable:
        """Call `callback(there)` when somebody begins to answer `key` and when nobody does.

        For a sender that was not heard: it need not sleep out its pause when the other side or
        the router returns. The first call comes as soon as somebody is there.
        """

    def declare_alive(self, key: str) -> Closable:
        """Hold a liveliness token until it is closed or this process dies."""

    def watch_alive(self, key: str, callback: Callable[[str, bool], None]) -> Closable:
        """Call `callback(key, alive)` for tokens that are there, appear and vanish.

        All tokens vanish when the router does and appear again when it is back. There is no list
        of the tokens that exist now: Zenoh's came back empty one time in two hundred just after
        a session was opened (measured with 1.10.2).
        """

    def interrupt(self) -> None:
        """End every `ask`, now and later, with BusClosed; everything else goes on."""

    def close(self) -> None:
        """End the session and everything declared on it; open queries are dropped."""


def check_size(payload: bytes, max_bytes: int) -> None:
    """Raise MessageTooLarge for what does not fit on the bus."""
    if len(payload) > max_bytes:
        raise MessageTooLarge(f"{len(payload)} bytes; the bus carries at most {max_bytes}")
