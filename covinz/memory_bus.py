"""A bus inside one process, for unit tests: the semantics of `ZenohBus` without a network.

Members of one `Hub` hear each other. Each member calls its callbacks from one thread of its own,
in the order in which things happened.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from functools import cache
from typing import Any

from covinz.bus import BusClosed, Closable, MessageTooLarge, Query, check_size
from covinz.config import BusConfig

logger = logging.getLogger(__name__)

_CONFIG = BusConfig()


@cache
def intersects(a: str, b: str) -> bool:
    """Whether some key matches both key expressions (``*``: one chunk, ``**``: any number).

    Source: https://zenoh.io/docs/manual/abstractions/#key-expression
    """
    return _intersects(tuple(a.split("/")), tuple(b.split("/")))


def _intersects(a: tuple[str, ...], b: tuple[str, ...]) -> bool:
    if not a or not b:
        return all(chunk == "**" for chunk in a + b)
    if a[0] == "**":
        return _intersects(a[1:], b) or _intersects(a, b[1:])
    if b[0] == "**":
        return _intersects(a, b[1:]) or _intersects(a[1:], b)
    return (a[0] == b[0] or "*" in (a[0], b[0])) and _intersects(a[1:], b[1:])


class Hub:
    """What the members of one bus share: who listens, answers, watches and is alive."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.subscribers: list[_Entry] = []
        self.answerers: list[_Entry] = []
        self.tokens: list[_Entry] = []
        self.token_watches: list[_Entry] = []
        self.answer_watches: list[_Entry] = []

    def join(self) -> InMemoryBus:
        """A new member."""
        return InMemoryBus(self)

    def changed(self) -> None:
        """Tell every watch what has changed for it."""
        for watch in self.answer_watches:
            watch.see({watch.key} if _matching(self.answerers, watch.key) else set())
        for watch in self.token_watches:
            watch.see({entry.key for entry in _matching(self.tokens, watch.key)})

    def leave(self, member: InMemoryBus) -> None:
        """Withdraw all that `member` declared."""
        for entries in (
            self.subscribers,
            self.answerers,
            self.tokens,
            self.token_watches,
            self.answer_watches,
        ):
            entries[:] = [entry for entry in entries if entry.owner is not member]
        self.changed()


class _Entry:
    """Something that a member declared on the hub."""

    def __init__(
        self, owner: InMemoryBus, among: list[_Entry], key: str, notify: Callable[..., object]
    ) -> None:
        self.owner = owner
        self.key = key
        self._among = among
        self._notify = notify
        self._seen: set[str] = set()

    def send(self, *arguments: Any) -> None:
        """Call the callback from the owner's thread."""
        self.owner.later(self._notify, *arguments)

    def see(self, now: set[str]) -> None:
        """For a watch: tell what appeared and what vanished since last time."""
        for key in sorted(now - self._seen):
            self.send(key, True)
        for key in sorted(self._seen - now):
            self.send(key, False)
        self._seen = now

    def close(self) -> None:
        """Withdraw it."""
        with self.owner.hub.lock:
            if self in self._among:
                self._among.remove(self)
                self.owner.hub.changed()


class _Wait:
    """An asker's wait for the end of all queries that its question became."""

    def __init__(self) -> None:
        self.replies: list[bytes] = []
        self.over = threading.Event()
        self._lock = threading.Lock()
        self._open: set[_MemoryQuery] = set()

    def start(self, queries: list[_MemoryQuery]) -> None:
        with self._lock:
            self._open.update(queries)
            if not self._open:
                self.over.set()

    def is_open(self, query: _MemoryQuery) -> bool:
        with self._lock:
            return query in self._open

    def end(self, query: _MemoryQuery, reply: bytes | None) -> bool:
        """End one query; False when it had ended before."""
        with self._lock:
            if query not in self._open:
                return False
            self._open.remove(query)
            if reply is not None:
                self.replies.append(reply)
            if not self._open:
                self.over.set()
            return True


class _MemoryQuery:
    """A question to one answerer."""

    def __init__(self, key: str, payload: bytes, wait: _Wait) -> None:
        self.key = key
        self.payload = payload
        self._wait = wait

    def reply(self, payload: bytes) -> None:
        try:
            check_size(payload, _CONFIG.max_message_bytes)
        except MessageTooLarge:
            self.drop()
            raise
        if not self._wait.end(self, payload):
            logger.warning("a second reply to a query on %s was not sent", self.key)

    def drop(self) -> None:
        self._wait.end(self, None)

    @property
    def is_open(self) -> bool:
        return self._wait.is_open(self)


class InMemoryBus:
    """One member of a hub; see `covinz.bus.Bus` for what the methods do.

    Args:
        hub: The other members; alone when absent.
    """

    def __init__(self, hub: Hub | None = None) -> None:
        self.hub = hub or Hub()
        self._calls: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._asked: list[_MemoryQuery] = []  # of others, to be dropped when this member closes
        self._waits: list[_Wait] = []
        self._interrupted = False
        self._closed = False
        self._thread = threading.Thread(target=self._deliver, name="memory-bus", daemon=True)
        self._thread.start()

    def put(self, key: str, payload: bytes) -> None:
        """See `Bus.put`."""
        check_size(payload, _CONFIG.max_message_bytes)
        with self.hub.lock:
            if not self._closed:
                for entry in _matching(self.hub.subscribers, key):
                    entry.send(key, bytes(payload))

    def subscribe(self, key: str, callback: Callable[[str, bytes], None]) -> Closable:
        """See `Bus.subscribe`."""
        return self._add(self.hub.subscribers, key, callback)

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        """See `Bus.ask`."""
        check_size(payload, _CONFIG.max_message_bytes)
        wait = _Wait()
        with self.hub.lock:
            self._raise_if_interrupted()
            self._waits.append(wait)
            answerers = _matching(self.hub.answerers, key)
            queries = [_MemoryQuery(key, bytes(payload), wait) for _ in answerers]
            wait.start(queries)
            for entry, query in zip(answerers, queries, strict=True):
                entry.owner.asked(entry, query)
        wait.over.wait(_CONFIG.query_timeout_s if timeout_s is None else timeout_s)
        with self.hub.lock:
            self._waits.remove(wait)
            self._raise_if_interrupted()
        return list(wait.replies)

    def answer(self, key: str, callback: Callable[[Query], None]) -> Closable:
        """See `Bus.answer`."""

        def receive(query: _MemoryQuery) -> None:
            try:
                callback(query)
            except BaseException:
                query.drop()
                raise

        return self._add(self.hub.answerers, key, receive)

    def watch_answered(self, key: str, callback: Callable[[bool], None]) -> Closable:
        """See `Bus.watch_answered`."""
        return self._add(self.hub.answer_watches, key, lambda _, there: callback(there))

    def declare_alive(self, key: str) -> Closable:
        """See `Bus.declare_alive`."""
        return self._add(self.hub.tokens, key, lambda: None)

    def watch_alive(self, key: str, callback: Callable[[str, bool], None]) -> Closable:
        """See `Bus.watch_alive`."""
        return self._add(self.hub.token_watches, key, callback)

    def alive(self, key: str) -> list[str]:
        """Keys of the tokens that exist now, sorted; for tests, Zenoh has no such sure answer."""
        with self.hub.lock:
            self._raise_if_interrupted()
            return sorted({entry.key for entry in _matching(self.hub.tokens, key)})

    def interrupt(self) -> None:
        """See `Bus.interrupt`."""
        with self.hub.lock:
            self._interrupted = True
            for wait in self._waits:
                wait.over.set()

    def close(self) -> None:
        """See `Bus.close`."""
        self.interrupt()
        with self.hub.lock:
            self._closed = True
            self.hub.leave(self)
            asked, self._asked = self._asked, []
            for query in asked:
                query.drop()
        self._calls.put(None)
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def later(self, callback: Callable[..., object], *arguments: Any) -> None:
        """Call from this member's thread."""
        self._calls.put(lambda: callback(*arguments))

    def asked(self, entry: _Entry, query: _MemoryQuery) -> None:
        """Another member's question to something declared here."""
        self._asked = [other for other in self._asked if other.is_open] + [query]
        entry.send(query)

    def _add(self, among: list[_Entry], key: str, callback: Callable[..., object]) -> _Entry:
        if not all(key.split("/")):
            raise ValueError(f"not a key expression: {key!r}")
        with self.hub.lock:
            if self._closed:
                raise BusClosed(f"cannot declare {key}: the bus is closed")
            entry = _Entry(self, among, key, callback)
            among.append(entry)
            self.hub.changed()
        return entry

    def _raise_if_interrupted(self) -> None:
        if self._interrupted:
            raise BusClosed("the bus is closed")

    def _deliver(self) -> None:
        while (call := self._calls.get()) is not None:
            try:
                call()
            except Exception:
                logger.exception("a bus callback failed")


def _matching(entries: list[_Entry], key: str) -> list[_Entry]:
    return [entry for entry in entries if intersects(entry.key, key)]
