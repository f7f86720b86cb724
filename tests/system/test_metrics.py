"""/healthz, /readyz and /metrics of a real server that is at work, loses its router and hangs."""

from __future__ import annotations

import json
import os
import re
import signal
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from covinz import client, metrics
from covinz.agent import Agent
from tests.processes import PATIENCE_S, Processes
from tests.uploads import content, features

SERVICES = ("router", "ingest", "place_recognition", "loop_solver", "optimizer")
# A place comes back after so many keyframes.
PERIOD = 25


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Processes]:
    monkeypatch.setenv("COVINZ__HEALTH__PORT", "0")
    monkeypatch.setenv("COVINZ__PLACE_RECOGNITION__MIN_LOOP_S", "0")
    with Processes(tmp_path) as processes:
        processes.start(*SERVICES)
        yield processes


def url(server: Processes, name: str) -> str:
    """Where a service said that it tells."""
    (found,) = re.findall(r"health and metrics at (http://127\.0\.0\.1:\d+)", server.log_of(name))
    return str(found)


def get(address: str) -> tuple[int, bytes]:
    try:
        with urllib.request.urlopen(address, timeout=PATIENCE_S) as reply:
            return int(reply.status), reply.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


def readiness(server: Processes, name: str) -> dict[str, bool]:
    code, body = get(f"{url(server, name)}/readyz")
    found: dict[str, bool] = json.loads(body)
    assert (code == 200) == found["ok"]
    return found


def until(condition: Callable[[], bool]) -> None:
    deadline, tick = time.monotonic() + PATIENCE_S, threading.Event()
    while not condition():
        assert time.monotonic() < deadline
        tick.wait(0.05)


def samples(server: Processes, name: str) -> dict[tuple[str, str], float]:
    """Value of each sample by its name and its labels' values."""
    code, body = get(f"{url(server, name)}/metrics")
    assert code == 200
    return {
        (sample.name, ",".join(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(body.decode())
        for sample in family.samples
    }


def send(server: Processes, folder: Path, count: int) -> None:
    with Agent("a1", server.endpoint, folder / "spool.sqlite") as agent:
        for seq in range(count):
            made = content(seq)
            agent.send(replace(made, features=features(200, seq % PERIOD)))
        assert agent.wait_delivered(PATIENCE_S)


def test_what_happened_is_told_by_each_process(server: Processes, tmp_path: Path) -> None:
    for name in SERVICES:
        assert get(f"{url(server, name)}/healthz")[0] == 200
        until(lambda name=name: readiness(server, name)["ok"])  # type: ignore[misc]
        assert get(f"{url(server, name)}/else")[0] == 404
    count = 2 * PERIOD
    send(server, tmp_path, count)
    client.wait_idle(server.bus, PATIENCE_S)
    told = {name: samples(server, name) for name in SERVICES}

    ingest, solver, optimizer = told["ingest"], told["loop_solver"], told["optimizer"]
    assert ingest["covinz_ingest_keyframes_total", "a1"] == count
    assert ingest["covinz_ingest_bytes_total", "a1"] > 7000 * count
    assert ingest["covinz_ingest_ack_seconds_count", ""] >= count
    assert optimizer["covinz_optimizer_keyframes", ""] == count
    jobs = told["place_recognition"]["covinz_place_recognition_candidates_total", ""]
    assert jobs >= PERIOD - 5
    assert solver["covinz_loop_solver_jobs_total", ""] == jobs
    assert solver["covinz_loop_solver_solve_seconds_count", ""] == jobs
    by_outcome = [
        value for (name, _), value in solver.items() if re.search("accepted|rejected", name)
    ]
    assert sum(by_outcome) == jobs
    documented = set(re.findall(r"`(\w+)", metrics.table()))
    for found in told.values():
        assert found["process_resident_memory_bytes", ""] > 1e7
        ours = {name for name, _ in found if name.startswith("covinz_")}
        assert {re.sub(r"_(bucket|count|sum)$", "", name) for name in ours} <= documented


def test_without_its_router_a_process_lives_but_is_not_ready(server: Processes) -> None:
    until(lambda: readiness(server, "ingest")["ok"])
    server.kill("router")
    until(lambda: not readiness(server, "ingest")["connected"])
    assert get(f"{url(server, 'ingest')}/healthz")[0] == 200
    server.start("router")
    until(lambda: readiness(server, "ingest")["ok"])


def test_a_follower_is_ready_when_it_has_read_the_log(server: Processes, tmp_path: Path) -> None:
    send(server, tmp_path, 5)
    server.kill("optimizer")
    (tmp_path / "optimizer.log").unlink()
    os.kill(server.pid("ingest"), signal.SIGSTOP)  # the log cannot be read
    server.start("optimizer")
    found = readiness(server, "optimizer")
    assert found["open"] and not found["caught_up"] and not found["ok"]
    os.kill(server.pid("ingest"), signal.SIGCONT)
    until(lambda: readiness(server, "optimizer")["ok"])
    assert server.status("optimizer").cursor == 5
