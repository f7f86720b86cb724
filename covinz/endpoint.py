"""What a process tells over HTTP: ``/healthz``, ``/readyz`` and ``/metrics``.

Source: decision 0030.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from covinz import codec, keyexprs, metrics
from covinz.bus import Bus, BusClosed
from covinz.config import HealthConfig
from covinz.telemetry import Telemetry
from covinz.types import Status
from covinz.watch import Watch

logger = logging.getLogger(__name__)

# The main loop has so long to say how far it is; below Prometheus' own limit of 10 s. [s]
ANSWER_S = 5.0
# Who connects and says nothing is let go. [s]
SILENCE_S = 10.0
# What reads the log is ready when it has read what was there when it was first asked.
FOLLOWERS = ("place_recognition", "optimizer")


class OwnQuestion:
    """A process's question to its own main loop; a `covinz.bus.Query`."""

    key = "covinz/service"
    payload = b""

    def __init__(self) -> None:
        self._answer = b""
        self._ended = threading.Event()

    def reply(self, payload: bytes) -> None:
        """Answer it."""
        self._answer = payload
        self._ended.set()

    def drop(self) -> None:
        """End it without an answer."""
        self._ended.set()

    def wait(self, timeout_s: float) -> bytes:
        """The answer; empty when there is none in time."""
        self._ended.wait(timeout_s)
        return self._answer


@dataclass(slots=True, eq=False)
class Probe:
    """Looks at one process from inside.

    Attributes:
        service: Kind of process.
        ask_status: Way to its main loop.
        bus: To ask ingest how long the log is.
        is_connected: Whether there is a router now.
        watch: Work that may be stuck.
        telemetry: Durations.
    """

    service: str
    ask_status: Callable[[OwnQuestion], object]
    bus: Bus
    is_connected: Callable[[], bool]
    watch: Watch
    telemetry: Telemetry
    _goal: Status | None = field(default=None, init=False)
    _caught_up: bool = field(default=False, init=False)

    def status(self) -> Status | None:
        """What the main loop says; None when it does not in time."""
        question = OwnQuestion()
        self.ask_status(question)
        try:
            return codec.decode(question.wait(ANSWER_S), Status)
        except codec.MalformedMessage:
            return None

    def health(self) -> dict[str, object]:
        """Alive: no work is stuck; ``ok`` sums up."""
        stuck = self.watch.overdue()
        return {"ok": stuck is None, "stuck": stuck.what if stuck else None}

    def readiness(self) -> dict[str, object]:
        """Ready: connected, files open, the log read; ``ok`` sums up."""
        status = self.status()
        found: dict[str, object] = {
            "connected": self.is_connected(),
            "open": status is not None,
            "caught_up": status is not None and self._has_caught_up(status),
        }
        return {"ok": all(found.values()), **found}

    def metrics(self) -> bytes:
        """See `covinz.metrics`."""
        return metrics.render(self.service, self.status(), self.telemetry.distributions())

    def _has_caught_up(self, own: Status) -> bool:
        if self.service not in FOLLOWERS or self._caught_up:
            return True
        try:
            replies = self.bus.ask(keyexprs.service_status("ingest", "*"), b"", ANSWER_S)
        except BusClosed:
            return False
        if self._goal is None and replies:
            self._goal = codec.decode(replies[0], Status)
        goal = self._goal
        if goal is not None:
            self._caught_up = own.log_id == goal.log_id and own.cursor >= goal.cursor
        return self._caught_up


class HealthEndpoint:
    """The HTTP server of one process, in threads of its own.

    Args:
        config: Where it listens.
        port: In place of the configuration's.
        probe: What it tells.

    Raises:
        OSError: If it cannot listen there.
    """

    def __init__(self, config: HealthConfig, port: int, probe: Probe) -> None:
        handler = type("Handler", (_Handler,), {"probe": probe})
        self._server = ThreadingHTTPServer((config.address, port), handler)
        self._server.daemon_threads = True
        threading.Thread(
            target=self._server.serve_forever, args=(0.1,), name="http", daemon=True
        ).start()

    @property
    def url(self) -> str:
        """Where it is."""
        host, port = self._server.server_address[:2]
        return f"http://{host!s}:{port}"

    def close(self) -> None:
        """Listen no more."""
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    probe: Probe
    timeout = SILENCE_S

    def do_GET(self) -> None:  # the name that the library calls
        match self.path.partition("?")[0]:
            case "/healthz":
                self._tell(self.probe.health())
            case "/readyz":
                self._tell(self.probe.readiness())
            case "/metrics":
                self._send(200, "text/plain; version=0.0.4; charset=utf-8", self.probe.metrics())
            case _:
                self._send(404, "text/plain", b"/healthz, /readyz or /metrics\n")

    def log_message(self, format: str, *args: object) -> None:
        logger.debug(format, *args)

    def _tell(self, found: dict[str, object]) -> None:
        body = json.dumps(found).encode() + b"\n"
        self._send(200 if found["ok"] else 503, "application/json", body)

    def _send(self, code: int, kind: str, body: bytes) -> None:
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)
