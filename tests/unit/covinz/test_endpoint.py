"""A process seen over HTTP, over an in-memory bus."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from collections.abc import Callable
from contextlib import closing

import pytest

from covinz import codec, endpoint, keyexprs
from covinz.config import Config, HealthConfig
from covinz.endpoint import HealthEndpoint, OwnQuestion, Probe
from covinz.memory_bus import Hub
from covinz.telemetry import Telemetry
from covinz.types import Status
from covinz.watch import Watch

CONFIG = HealthConfig()
LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAV"


def get(url: str) -> tuple[int, bytes]:
    try:
        with urllib.request.urlopen(url, timeout=20.0) as reply:
            return int(reply.status), reply.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


def answer(status: Status) -> Callable[[OwnQuestion], None]:
    return lambda question: question.reply(codec.encode(status))


def make(
    service: str = "optimizer", cursor: int = 0, log_id: str = "", watch: Watch | None = None
) -> Probe:
    own = Status(service, service, log_id, cursor, 0, 0, False)
    return Probe(service, answer(own), Hub().join(), lambda: True, watch or Watch(), Telemetry())


def test_work_that_is_stuck_is_told() -> None:
    watch = Watch()
    with closing(HealthEndpoint(CONFIG, 0, make(watch=watch))) as server:
        code, body = get(f"{server.url}/healthz")
        assert (code, json.loads(body)) == (200, {"ok": True, "stuck": None})
        watch.work("a job", -1.0).begin()
        code, body = get(f"{server.url}/healthz")
        assert (code, json.loads(body)) == (503, {"ok": False, "stuck": "a job"})


def test_a_main_loop_that_does_not_answer_is_not_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endpoint, "ANSWER_S", 0.01)
    probe = make()
    probe.ask_status = lambda query: None
    assert probe.readiness() == {
        "ok": False,
        "connected": True,
        "open": False,
        "caught_up": False,
    }
    assert b'covinz_service_up{service="optimizer"} 0.0' in probe.metrics()


def test_a_follower_is_ready_once_it_has_read_what_was_there() -> None:
    probe = make(cursor=2, log_id=LOG)
    assert not probe.readiness()["caught_up"]  # nobody says how long the log is
    hub = Hub()
    ingest = Status("ingest", "ingest", LOG, 3, 0, 0, False)
    hub.join().answer(
        keyexprs.service_status("ingest", "ingest"), lambda query: query.reply(codec.encode(ingest))
    )
    probe.bus = hub.join()
    assert not probe.readiness()["caught_up"]
    probe.ask_status = answer(Status("optimizer", "optimizer", LOG, 3, 0, 0, False))
    assert probe.readiness()["ok"]
    probe.ask_status = answer(Status("optimizer", "optimizer", LOG, 0, 0, 0, False))
    assert probe.readiness()["ok"]  # it has begun to serve, and goes on


def test_a_port_in_use_is_an_error() -> None:
    with closing(HealthEndpoint(CONFIG, 0, make())) as server:
        port = int(server.url.rpartition(":")[2])
        with pytest.raises(OSError):
            HealthEndpoint(CONFIG, port, make())


def test_nothing_listens_by_default() -> None:
    assert Config().health.port is None
