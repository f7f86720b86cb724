"""`python -m covinz.health` asks real processes: what it says and with which code it ends."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from covinz.health import Health
from tests.processes import CHECKOUT, PATIENCE_S, Processes


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Processes]:
    with Processes(tmp_path) as processes:
        yield processes


def health(endpoint: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "covinz.health", *arguments],
        cwd=CHECKOUT,
        env=dict(os.environ, COVINZ__BUS__ENDPOINT=endpoint),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )


def test_a_process_that_answers_is_healthy_and_one_that_is_gone_is_not(server: Processes) -> None:
    server.start("router", "ingest")
    patient = ("--timeout", str(PATIENCE_S))
    for name in ("router", "ingest"):
        found = health(server.endpoint, name, *patient)
        assert found.returncode == Health.ANSWERS, found.stderr
        assert found.stdout == f"{name}/{name}: cursor 0, pending 0, leased 0\n"
    server.kill("ingest")
    found = health(server.endpoint, "ingest", "--timeout", "1")
    assert (found.returncode, found.stderr) == (Health.SILENT, "ingest/ingest does not answer\n")


def test_no_router_and_no_configuration_are_told_apart(server: Processes) -> None:
    found = health(server.endpoint, "ingest", "--timeout", "0.2")
    assert found.returncode == Health.NO_ROUTER
    assert found.stderr == f"no router at {server.endpoint}\n"
    found = health("nonsense", "ingest")
    assert found.returncode == Health.UNUSABLE
    assert "not an endpoint: 'nonsense'" in found.stderr


def test_it_starts_without_what_draws_or_prints_tables() -> None:
    """Every few seconds in every container: what it imports is what it costs."""
    program = "import sys, covinz.health; print(*sys.modules)"
    loaded = subprocess.check_output([sys.executable, "-c", program], cwd=CHECKOUT, text=True)
    assert not {"matplotlib", "rich", "typer", "cv2", "covinz_core", "prometheus_client"} & set(
        loaded.split()
    )
