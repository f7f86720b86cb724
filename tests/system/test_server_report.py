"""`covinz report`: a server that runs is evaluated with what a player left elsewhere."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from covinz.supervisor import child_environment
from tests.processes import CHECKOUT, PATIENCE_S, Processes

pytestmark = pytest.mark.slow

SMALL = Path(__file__).with_name("small.yaml")


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *map(str, arguments)],
        cwd=CHECKOUT,
        env=child_environment(os.environ),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )


def test_the_report_of_a_running_server(tmp_path: Path) -> None:
    played, out = tmp_path / "played", tmp_path / "report"
    with Processes(tmp_path) as server:
        server.start("router", "ingest", "place_recognition", "loop_solver", "optimizer")
        where = ("--endpoint", server.endpoint)
        files = ("--spool", tmp_path / "spool", "--summary", played / "agents.json")
        done = run("covinz_agents.play", SMALL, *where, *files, "--no-progress")
        assert done.returncode == 0, done.stderr
        done = run("covinz.cli", "report", SMALL, "--played", played, "--out", out, *where)
        assert done.returncode == 0, done.stderr
        nowhere = run("covinz.cli", "report", SMALL, "--played", tmp_path, *where)
    made = json.loads((out / "report.json").read_text())
    assert made["keyframes_lost"] == 0
    assert sum(agent["keyframes"] for agent in made["agents"].values()) > 10
    loops = made["loops"]
    assert 0 < loops["candidates"] == loops["accepted"] + sum(loops["rejected"].values())
    assert made["joint_ate_before_m"] is not None
    assert made["server_s"] is None
    assert (out / "top_view.png").read_bytes().startswith(b"\x89PNG")
    assert nowhere.returncode == 1
    assert nowhere.stderr.startswith("covinz: no summary of a player in ")
