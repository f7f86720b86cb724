"""What the benchmarks gather in one process is what a server is sent, asks itself and answers."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.fleet import gather
from covinz.candidates import LOOP, candidates, read_candidates
from covinz.scenario import load_scenario
from covinz.types import JobRecord, JobState
from services.loop_solver.solver import LoopSolver

pytestmark = pytest.mark.slow

CHECKOUT = Path(__file__).resolve().parents[2]
SMALL = Path(__file__).with_name("small.yaml")


def test_jobs_outcomes_and_bytes_are_those_of_a_lockstep_run(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "covinz.cli", "run", str(SMALL), "--lockstep"]
    command += ["--profile", "fast", "--out", str(tmp_path / "run")]
    subprocess.run(command, cwd=CHECKOUT, check=True, timeout=240, capture_output=True)
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    rows = read_candidates(tmp_path / "run" / "candidates.csv")

    fleet = gather(load_scenario(SMALL))
    assert fleet.num_bytes == {name: of["bytes"] for name, of in report["agents"].items()}
    solver = LoopSolver(fleet.config("fast").loop_solver, fleet)
    records = [
        JobRecord(job, JobState.DONE, 1, solver.solve(job)) for job in fleet.attempts("fast")
    ]
    # Of each: query, candidate, score, outcome and what was counted.
    assert [row[:6] for row in candidates(records)] == [row[:6] for row in rows]
    assert sum(row.outcome == LOOP for row in rows) >= 5
