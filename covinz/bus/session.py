"""The bus over Zenoh: a session in client mode that may lose its router and get it back."""
# Parts of Zenoh's own type hints lack a return type.
# mypy: untyped-calls-exclude=zenoh

from __future__ import annotations

import atexit
import functools
import logging
import queue
import threading
from collections.abc import Callable
from typing import Any

import zenoh

from covinz import codec
from covinz.bus.link import LinkReport
from covinz.bus.protocol import BusClosed, Closable, Query, check_size
from covinz.bus.settings import client_settings
from covinz.config import BusConfig

logger = logging.getLogger(__name__)

# Pauses between attempts to reach a router that is not there grow from ... to ... [s]
_MIN_RETRY_S = 0.1
_MAX_RETRY_S = 1.0
# `close` waits so long for an attempt under way, which then closes what it opens. [s]
_CLOSE_S = 1.0
# A session closes in milliseconds, or never: its router may have vanished. [s]
_SESSION_CLOSE_S = 2.0
# Messages that wait for one callback.
_MAX_WAITING = 4096


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
            check_size(payload, self._max_bytes)
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

    Source: decision 0007; the measurements behind it are in its text.
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
        self._link = LinkReport(config)
        self._thread = threading.Thread(target=self._connect, name="bus-connect", daemon=True)
        self._thread.start()
        # Zenoh's threads must not call into an interpreter that is being taken down.
        atexit.register(self.close)

    @classmethod
    def open(cls, config: BusConfig, wait_s: float = 1.0) -> ZenohBus:
        """Open the bus; gives the router `wait_s` seconds to be there and goes on without it.

        Raises:
            BusError: If the endpoint is malformed.
        """
        bus = cls(config, client_settings(config))
        bus.wait_connected(wait_s)
        return bus

    def wait_connected(self, timeout_s: float | None = None) -> bool:
        """Wait for the first connection to the router; False when time ran out first."""
        return self._connected.wait(timeout_s)

    @property
    def is_connected(self) -> bool:
        """Whether there is a router now, as far as Zenoh knows: a silent one is given up late."""
        return self._link.is_there

    def put(self, key: str, payload: bytes) -> None:
        """See `Bus.put`."""
        check_size(payload, self._config.max_message_bytes)
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

        return self._add(
            key, lambda session: session.declare_subscriber(key, _from_own_thread(receive))
        )

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        """See `Bus.ask`."""
        check_size(payload, self._config.max_message_bytes)
        self._raise_if_interrupted()
        session = self._session
        if session is None:
            return []
        replies: list[bytes] = []
        ended = threading.Event()

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                replies.append(reply.ok.payload.to_bytes())
            elif reply.err is not None:
                logger.debug("%s: %s", key, reply.err.payload.to_bytes())

        try:
            session.get(
                key,
                zenoh.handlers.Callback(receive, ended.set, indirect=False),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
                payload=payload,
                encoding=_encoding(payload),
                timeout=self._config.query_timeout_s if timeout_s is None else timeout_s,
                cancellation_token=self._asking,
            )
        except zenoh.ZError:
            self._raise_if_interrupted()
            raise
        ended.wait()
        self._raise_if_interrupted()
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

        return self._add(
            key, lambda session: session.declare_queryable(key, _from_own_thread(receive))
        )

    def watch_answered(self, key: str, callback: Callable[[bool], None]) -> Closable:
        """See `Bus.watch_answered`."""

        def receive(status: zenoh.MatchingStatus) -> None:
            callback(status.matching)

        def declare(session: zenoh.Session) -> zenoh.Querier:
            querier = session.declare_querier(key, target=zenoh.QueryTarget.ALL)
            querier.declare_matching_listener(_from_own_thread(receive))
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
                key, _from_own_thread(receive), history=True
            ),
        )

    def interrupt(self) -> None:
        """See `Bus.interrupt`."""
        self._interrupted.set()  # before the waits end, so that they know why
        self._asking.cancel()

    def close(self) -> None:
        """See `Bus.close`."""
        atexit.unregister(self.close)
        self._closing.set()
        self._link.end()
        self.interrupt()
        self._thread.join(_CLOSE_S)
        with self._lock:
            session, self._session = self._session, None
            self._declarations.clear()
        if session is not None:
            _close(session)

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
                    self._link.say_missing()
                pause_s = min(2 * pause_s, _MAX_RETRY_S)
            else:
                if self._attach(session):
                    self._link.follow(session)
                return

    def _attach(self, session: zenoh.Session) -> bool:
        """Make all that was declared so far; False when the bus was closed meanwhile."""
        with self._lock:
            is_late = self._closing.is_set()
            self._session = None if is_late else session
            waiting = list(self._declarations)
        if is_late:
            _close(session)
            return False
        for declaration in waiting:
            self._apply(declaration, session)
        self._connected.set()
        return True

    def _apply(self, declaration: _Declaration, session: zenoh.Session) -> None:
        try:
            declaration.apply(session)
        except zenoh.ZError:
            if not self._closing.is_set():  # otherwise it is closed with the session
                raise

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
            self._apply(declaration, session)
        return declaration

    def _remove(self, declaration: _Declaration) -> None:
        with self._lock:
            if declaration in self._declarations:
                self._declarations.remove(declaration)

    def _raise_if_interrupted(self) -> None:
        if self._interrupted.is_set():
            raise BusClosed("the bus was closed or interrupted")


def _close(session: zenoh.Session) -> None:
    """Close a session, but do not wait for ever."""

    def close() -> None:
        try:
            session.close()
        except zenoh.ZError as error:
            logger.debug("closing the session: %s", error)

    closing = threading.Thread(target=close, name="bus-close", daemon=True)
    closing.start()
    closing.join(_SESSION_CLOSE_S)
    if closing.is_alive():
        logger.warning("the session does not close; leaving it as it is")


def _from_own_thread(callback: Callable[[Any], None]) -> Any:
    """A handler that calls `callback` from a thread of its own, which ends with the declaration.

    Zenoh's own threads for callbacks keep a process that forgot to close its bus from ending.
    Callbacks do not block; what comes while one does is dropped beyond `_MAX_WAITING`, so that a
    query ends and its sender asks again.
    """
    arguments: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def call() -> None:
        while (argument := arguments.get()) is not None:
            try:
                callback(argument)
            except Exception:
                logger.exception("a bus callback failed")

    def arrive(argument: Any) -> None:
        if arguments.qsize() < _MAX_WAITING:
            arguments.put(argument)
        else:
            logger.error("a message is dropped: a bus callback has blocked for too long")

    threading.Thread(target=call, name="bus-callback", daemon=True).start()
    return zenoh.handlers.Callback(arrive, lambda: arguments.put(None), indirect=False)


def _encoding(payload: bytes) -> zenoh.Encoding:
    """Encoding that carries the schema's name, e.g. ``...;covinz.Keyframe/1``."""
    try:
        return _encoding_of(codec.schema_name(payload))
    except codec.MalformedMessage:
        return zenoh.Encoding.APPLICATION_OCTET_STREAM


@functools.cache
def _encoding_of(schema: str) -> zenoh.Encoding:
    return zenoh.Encoding.APPLICATION_OCTET_STREAM.with_schema(schema)
