"""Claim: a loop takes a fraction of the time of the paper's profile, and a robot sends little.

The paper's Table III. Each scenario is run by `covinz run --lockstep` with one worker, once a
profile: loops found, and kB/s that a robot sends at the speed at which it was recorded. A sample of
the very jobs of that run is then solved again in this process, for the CPU time of one thread by
stage; `loop` counts the attempts that became loops, as the paper's "time per loop", `attempt` all.

`published` holds the paper's own figures (EuRoC machine hall, five robots with ORB-SLAM3, a laptop
of 2015): another data set, other odometry and another machine, so they only tell the magnitude.

    python -m benchmarks.runtime_traffic [--data FOLDER] [--scenarios NAME ...] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import covinz_core as core
import cv2
import numpy as np

from benchmarks.fleet import Fleet, gather
from benchmarks.loop_figures import Timed, rounded, stage_figures, time_figures, timed
from covinz.scenario import load_scenario
from services.loop_solver.solver import LoopSolver

_REPOSITORY = Path(__file__).resolve().parents[1]
_DATA = Path(os.environ.get("COVINZ_DATA", _REPOSITORY.parent / "shared" / "data"))
PROFILES = ("paper", "fast")
# Scenario, and the recording that it needs.
SCENARIOS = {"hall": None, "redkitchen": "redkitchen"}
DEFAULT_SAMPLE = 100
# Table III of the paper: loops found, mean and standard deviation of the time per loop, and what a
# robot sends.
PUBLISHED = {
    "COVINS-G": {
        "loops": 75,
        "loop_ms_mean": 213,
        "loop_ms_std": 171,
        "kB_per_s_per_agent": 179.74,
    },
    "COVINS": {"loops": 57, "loop_ms_mean": 35, "loop_ms_std": 23, "kB_per_s_per_agent": 486.41},
}


def run(name: str, profile: str, data: Path) -> dict[str, Any]:
    """The report of a lockstep run."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / name
        command = [sys.executable, "-m", "covinz.cli", "run", f"scenarios/{name}.yaml"]
        subprocess.run(
            [*command, "--lockstep", "--profile", profile, "--out", str(out)],
            cwd=_REPOSITORY,
            env=os.environ | {"COVINZ_DATA": str(data)},
            stdout=sys.stderr,
            check=True,
        )
        report: dict[str, Any] = json.loads((out / "report.json").read_text())
        return report


def sampled(fleet: Fleet, profile: str, count: int) -> list[Timed]:
    """As many of the jobs of a run, evenly spread over it, solved again."""
    jobs = fleet.attempts(profile)
    solver = LoopSolver(fleet.config(profile).loop_solver, fleet)
    chosen = np.unique(np.linspace(0, len(jobs) - 1, min(count, len(jobs))).round().astype(int))
    return [timed(solver.prepared(jobs[i])) for i in chosen]


def figures(report: Mapping[str, Any], attempts: Sequence[Timed]) -> dict[str, Any]:
    """What a run came to, and the times of its sample."""
    loops = [attempt for attempt in attempts if isinstance(attempt.result, core.LoopEstimate)]
    return {
        "candidates": report["loops"]["candidates"],
        "loops": report["loops"]["accepted"],
        "wrong": report["loops"]["wrong"],
        "maps": len(report["maps"]),
        "agents": len(report["agents"]),
        "kB_per_s_per_agent": report["kB_per_s_per_agent"],
        "sampled": len(attempts),
        "sampled_loops": len(loops),
        **prefixed("attempt_", times(attempts)),
        **prefixed("loop_", times(loops)),
        "attempt_stage_ms_mean": stage_figures([attempt.stage_ms for attempt in attempts]),
        "loop_stage_ms_mean": stage_figures([attempt.stage_ms for attempt in loops]),
    }


def times(attempts: Sequence[Timed]) -> dict[str, float | None]:
    """Mean, standard deviation, median and 95 % quantile of the times [ms]."""
    values = [attempt.ms for attempt in attempts]
    spread = {"ms_mean": rounded(np.mean(values)), "ms_std": rounded(np.std(values))}
    return (spread if values else dict.fromkeys(("ms_mean", "ms_std"))) | time_figures(values)


def prefixed(prefix: str, values: Mapping[str, float | None]) -> dict[str, float | None]:
    """The same values under longer names."""
    return {prefix + name: value for name, value in values.items()}


def measure(data: Path, scenarios: Iterable[str], sample: int) -> dict[str, Any]:
    """All figures of the claim; a scenario whose recording is not there is left out."""
    results: dict[str, Any] = {}
    for name in scenarios:
        recording = SCENARIOS[name]
        if recording is not None and not (data / recording).is_dir():
            sys.stderr.write(f"{name} is left out: needs {data / recording}\n")
            continue
        scenario = load_scenario(
            _REPOSITORY / "scenarios" / f"{name}.yaml", os.environ | {"COVINZ_DATA": str(data)}
        )
        # Before the fleet: the run leaves rendered images in the cache.
        reports = {profile: run(name, profile, data) for profile in PROFILES}
        fleet = gather(scenario)
        results[name] = {
            profile: figures(report, sampled(fleet, profile, sample))
            for profile, report in reports.items()
        }
        sys.stderr.write(f"{name}: {json.dumps(results[name])}\n")
    return {
        "benchmark": "runtime_traffic",
        "machine": platform.processor() or platform.machine(),
        "isa": core.best_instruction_set().name.lower(),
        "published": PUBLISHED,
        "scenarios": results,
    }


def main() -> int:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=_DATA, help="folder of the recordings")
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS))
    parser.add_argument(
        "--sample", type=int, default=DEFAULT_SAMPLE, help="jobs of a run that are timed"
    )
    parser.add_argument("--json", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    # One thread, so that its CPU time is all the time.
    cv2.setNumThreads(1)
    made = measure(arguments.data, arguments.scenarios, arguments.sample)
    text = json.dumps(made, indent=2) + "\n"
    sys.stdout.write(text)
    if arguments.json:
        arguments.json.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
