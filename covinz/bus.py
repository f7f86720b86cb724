"""The message bus: what every process needs of Zenoh, and the only module that imports it.

`Bus` is the protocol that the rest of covinz is written against. `ZenohBus` is the real one;
`covinz.memory_bus.InMemoryBus` plays it in unit tests. `open_router` is the hub in the middle.
"""
# Parts of Zenoh's own type hints lack a return type.
# mypy: untyped-calls-exclude=zenoh

from __future__ import annotations

import functools
import json
import logging
import threading
from collections.abc import Callable
from typing import Any, Protocol

import zenoh

from covinz import codec
from covinz.config import BusConfig

logger = logging.getLogger(__name__)

# A message on the link is this much larger than its payload: key, encoding, headers. [bytes]
_ENVELOPE_BYTES = 4096
# Pauses between attempts to reach a router that is not there grow from ... to ... [s]
_MIN_RETRY_S = 0.1
_MAX_RETRY_S = 1.0


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

        All tokens vanish when the router does and appear again when it is back.
        """

    def alive(self, key: str) -> list[str]:
        """Keys of the tokens that exist now, sorted."""

    def interrupt(self) -> None:
        """End every `ask`, now and later, with BusClosed; everything else goes on."""

    def close(self) -> None:
        """End the session and everything declared on it; open queries are dropped."""


class _ZenohQuery:
    """A question that came over Zenoh."""

    def __init__(self, query: zenoh.Query, answered_key: str, max_bytes: int) -> None:
        self.key = str(query.key_expr)
        self.payload = b"" if query.payload is None else query.payload.to_bytes()
        # An asker with wildcards tells the answers apart by the keys of those who answer.
        self._reply_key = self.key if "*" in answered_key else answered_key
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._query: zenoh.Query | None = query

    def reply(self, payload: bytes) -> None:
        query = self._end()
        if query is None:
            logger.warning("a second reply to a query on %s was not sent", self.key)
            return
        try:
            _check_size(payload, self._max_bytes)
            query.reply(self._reply_key, payload, encoding=_encoding(payload))
        except zenoh.ZError as error:
            logger.debug("the asker on %s is gone: %s", self.key, error)
        finally:
            query.drop()

    def drop(self) -> None:
        query = self._end()
        if query is not None:
            query.drop()

    def _end(self) -> zenoh.Query | None:
        with self._lock:
            query, self._query = self._query, None
            return query


class _Declaration:
    """Something declared on a session as soon as there is one, and until it is closed."""

    def __init__(
        self,
        declare: Callable[[zenoh.Session], Any],
        withdrawn: Callable[[_Declaration], None],
    ) -> None:
        self._declare = declare
        self._withdrawn = withdrawn
        self._lock = threading.Lock()
        self._entities: Any = None
        self._closed = False

    def apply(self, session: zenoh.Session) -> None:
        with self._lock:
            if not self._closed and self._entities is None:
                self._entities = self._declare(session)

    def close(self) -> None:
        with self._lock:
            self._closed = True
            entities, self._entities = self._entities, None
        self._withdrawn(self)
        if entities is not None:
            entities.undeclare()


class ZenohBus:
    """A session with the router, in client mode.

    `open` does not depend on the router: it may come, go and return at any time. Until it is
    there publications are lost, nobody answers, and declarations wait to be made.

    Source: decision 0002; the measurements behind it are in its text.
    """

    def __init__(self, config: BusConfig, settings: zenoh.Config) -> None:
        self._config = config
        self._settings = settings
        self._lock = threading.Lock()  # guards the next two
        self._session: zenoh.Session | None = None
        self._declarations: list[_Declaration] = []
        self._closing = threading.Event()
        self._connected = threading.Event()
        self._interrupted = threading.Event()
        self._asking = zenoh.CancellationToken()
        self._thread = threading.Thread(target=self._connect, name="bus-connect", daemon=True)
        self._thread.start()

    @classmethod
    def open(cls, config: BusConfig, wait_s: float = 1.0) -> ZenohBus:
        """Open the bus; gives the router `wait_s` seconds to be there and goes on without it.

        Raises:
            BusError: If the endpoint is malformed.
        """
        bus = cls(config, _client_settings(config))
        bus.wait_connected(wait_s)
        return bus

    def wait_connected(self, timeout_s: float | None = None) -> bool:
        """Wait for the first connection to the router; False when time ran out first."""
        return self._connected.wait(timeout_s)

    def put(self, key: str, payload: bytes) -> None:
        """See `Bus.put`."""
        _check_size(payload, self._config.max_message_bytes)
        session = self._session
        if session is None or self._closing.is_set():
            return
        try:
            session.put(
                key,
                payload,
                encoding=_encoding(payload),
                congestion_control=zenoh.CongestionControl.DROP,
            )
        except zenoh.ZError:
            if not self._closing.is_set():
                raise

    def subscribe(self, key: str, callback: Callable[[str, bytes], None]) -> Closable:
        """See `Bus.subscribe`."""

        def receive(sample: zenoh.Sample) -> None:
            callback(str(sample.key_expr), sample.payload.to_bytes())

        return self._add(key, lambda session: session.declare_subscriber(key, _logged(receive)))

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        """See `Bus.ask`."""
        _check_size(payload, self._config.max_message_bytes)
        timeout_s = self._config.query_timeout_s if timeout_s is None else timeout_s
        replies: list[bytes] = []

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                replies.append(reply.ok.payload.to_bytes())
            elif reply.err is not None:
                logger.debug("%s: %s", key, reply.err.payload.to_bytes())

        self._wait_for_replies(
            lambda session, handler: session.get(
                key,
                handler,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
                payload=payload,
                encoding=_encoding(payload),
                timeout=timeout_s,
                cancellation_token=self._asking,
            ),
            receive,
        )
        return replies

    def answer(self, key: str, callback: Callable[[Query], None]) -> Closable:
        """See `Bus.answer`."""

        def receive(question: zenoh.Query) -> None:
            query = _ZenohQuery(question, key, self._config.max_message_bytes)
            try:
                callback(query)
            except BaseException:
                query.drop()
                raise

        return self._add(key, lambda session: session.declare_queryable(key, _logged(receive)))

    def watch_answered(self, key: str, callback: Callable[[bool], None]) -> Closable:
        """See `Bus.watch_answered`."""

        def receive(status: zenoh.MatchingStatus) -> None:
            callback(status.matching)

        def declare(session: zenoh.Session) -> zenoh.Querier:
            querier = session.declare_querier(key, target=zenoh.QueryTarget.ALL)
            querier.declare_matching_listener(_logged(receive))
            return querier

        return self._add(key, declare)

    def declare_alive(self, key: str) -> Closable:
        """See `Bus.declare_alive`."""
        return self._add(key, lambda session: session.liveliness().declare_token(key))

    def watch_alive(self, key: str, callback: Callable[[str, bool], None]) -> Closable:
        """See `Bus.watch_alive`."""

        def receive(sample: zenoh.Sample) -> None:
            callback(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        return self._add(
            key,
            lambda session: session.liveliness().declare_subscriber(
                key, _logged(receive), history=True
            ),
        )

    def alive(self, key: str) -> list[str]:
        """See `Bus.alive`."""
        keys: set[str] = set()

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                keys.add(str(reply.ok.key_expr))

        self._wait_for_replies(
            lambda session, handler: session.liveliness().get(
                key,
                handler,
                timeout=self._config.query_timeout_s,
                cancellation_token=self._asking,
            ),
            receive,
        )
        return sorted(keys)

    def interrupt(self) -> None:
        """See `Bus.interrupt`."""
        self._interrupted.set()  # before the waits end, so that they know why
        self._asking.cancel()

    def close(self) -> None:
        """See `Bus.close`."""
        self._closing.set()
        self.interrupt()
        self._thread.join()
        with self._lock:
            session, self._session = self._session, None
            self._declarations.clear()
        if session is not None:
            session.close()

    def _connect(self) -> None:
        """Try until the router is there; from then on Zenoh itself reconnects for ever."""
        pause_s = _MIN_RETRY_S
        while not self._closing.is_set():
            try:
                session = zenoh.open(self._settings)
            except zenoh.ZError as error:
                logger.debug("no router at %s: %s", self._config.endpoint, error)
                self._closing.wait(pause_s)
                if pause_s < _MAX_RETRY_S <= 2 * pause_s:
                    logger.warning("no router at %s yet; trying on", self._config.endpoint)
                pause_s = min(2 * pause_s, _MAX_RETRY_S)
                continue
            with self._lock:
                self._session = session
                waiting = list(self._declarations)
            for declaration in waiting:
                declaration.apply(session)
            self._connected.set()
            return

    def _add(self, key: str, declare: Callable[[zenoh.Session], Any]) -> Closable:
        if self._closing.is_set():
            raise BusClosed(f"cannot declare {key}: the bus is closed")
        try:
            zenoh.KeyExpr(key)
        except zenoh.ZError as error:
            raise ValueError(f"not a key expression: {key!r}") from error
        declaration = _Declaration(declare, self._remove)
        with self._lock:
            self._declarations.append(declaration)
            session = self._session
        if session is not None:
            declaration.apply(session)
        return declaration

    def _remove(self, declaration: _Declaration) -> None:
        with self._lock:
            if declaration in self._declarations:
                self._declarations.remove(declaration)

    def _wait_for_replies(
        self,
        send: Callable[[zenoh.Session, Any], None],
        receive: Callable[[zenoh.Reply], None],
    ) -> None:
        """Send a question and wait for its end."""
        if self._interrupted.is_set():
            raise BusClosed("the bus is closed")
        session = self._session
        if session is None:
            return
        ended = threading.Event()
        try:
            send(session, zenoh.handlers.Callback(_logged(receive), ended.set, indirect=False))
        except zenoh.ZError as error:
            if self._interrupted.is_set():
                raise BusClosed("the bus is closed") from error
            raise
        ended.wait()
        if self._interrupted.is_set():
            raise BusClosed("the bus was closed during the wait")


def open_router(config: BusConfig) -> Closable:
    """Run the hub that all sessions connect to, in threads of this process.

    Raises:
        BusError: If the endpoint is malformed or somebody listens there already.
    """
    limit = config.max_message_bytes + _ENVELOPE_BYTES
    size_limit = {
        "id": "size",
        "flows": ["ingress"],
        "messages": ["put", "query", "reply"],
        "key_exprs": ["**"],
        "size_limit": limit,
    }
    settings = _settings(
        config,
        {
            "mode": "router",
            "listen/endpoints": [config.endpoint],
            "connect/endpoints": [],
            "low_pass_filter": [size_limit],
        },
    )
    try:
        return _Router(zenoh.open(settings))
    except zenoh.ZError as error:
        raise BusError(f"cannot listen on {config.endpoint}: {error}") from error


class _Router:
    """The hub while it runs."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    def close(self) -> None:
        """Stop; all sessions lose their connection and wait for the next router."""
        self._session.close()


def _client_settings(config: BusConfig) -> zenoh.Config:
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
        },
    )


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
            raise BusError(f"cannot use {name} = {value}: {error}") from error
    return settings


def _check_size(payload: bytes, max_bytes: int) -> None:
    if len(payload) > max_bytes:
        raise MessageTooLarge(f"{len(payload)} bytes; the bus carries at most {max_bytes}")


def _logged(callback: Callable[[Any], None]) -> Callable[[Any], None]:
    """`callback` with its exceptions logged, for threads that nobody watches."""

    @functools.wraps(callback)
    def guarded(argument: Any) -> None:
        try:
            callback(argument)
        except Exception:
            logger.exception("a bus callback failed")

    return guarded


def _encoding(payload: bytes) -> zenoh.Encoding:
    """Encoding that carries the schema's name, e.g. ``...;covinz.Keyframe/1``."""
    try:
        return _encoding_of(codec.schema_name(payload))
    except codec.MalformedMessage:
        return zenoh.Encoding.APPLICATION_OCTET_STREAM


@functools.cache
def _encoding_of(schema: str) -> zenoh.Encoding:
    return zenoh.Encoding.APPLICATION_OCTET_STREAM.with_schema(schema)
