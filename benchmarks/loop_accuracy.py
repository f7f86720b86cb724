"""Claim: on images the fast profile finds several times the paper's loops, rightly, and knows it.

The paper's Table I. Every attempt at a loop is made by `paper`, by `fast` and by `pnp`
(pnp_baseline.py, with the rigs of `paper`), one after the other. Rigs are place recognition's own
under each profile, motions and options the worker's own.

- `redkitchen`: real images and real RGB-D odometry; robots are frames 0-399, 300-699 and 600-999,
  keyframes at 0.15 m or 0.15 rad, attempts all pairs of different robots that are near by ground
  truth (0.7 m, 40 degrees, more than 2 s apart). Ground truth is good to 4 cm and 1.2 degrees a
  pair, which NEES adds to the covariance; `nees_mean_without_truth` does not.
- `redkitchen_elsewhere`: all pairs more than 1.5 m or 60 degrees apart (the room allows no more),
  which have little or nothing in common; a loop that is found all the same may be right.
- `elsewhere`: random pairs of `redkitchen` with `fr1_rpy`, another building: every loop is wrong.
- `fr1_rpy`: real images of a camera that only turns, odometry true but for stated drift; the
  attempts that place recognition makes, of which `paper` and `pnp` make up to 300, evenly spread.
- `hall`: rendered images, exact truth; attempts likewise.

`nees_mean` judges the covariance that a method gives: sampled by `paper`, of the adjustment with
the noise as its residuals show it by `fast`; `nees_analytic_mean` the latter's inverse Hessian
alone. Nothing in a solver was fitted to these recordings. Times are CPU times of one thread.

    python -m benchmarks.loop_accuracy [--data FOLDER] [--scenarios NAME ...] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import covinz_core as core
import cv2
import numpy as np

from benchmarks import pnp_baseline
from benchmarks.loop_attempts import DATA, DEFAULT_SCENARIOS, SCENARIOS, Attempts
from benchmarks.loop_figures import (
    NEES_LIMIT,
    Result,
    Tally,
    Timed,
    error_figures,
    nees_figures,
    rounded,
    stage_figures,
    time_figures,
    timed,
)
from covinz.types import Array, LoopJob
from services.loop_solver.solver import LoopSolver

METHODS = ("paper", "fast", "pnp")
# Rejections of a pose that was estimated: it is not clear, not certain or not near enough.
_ESTIMATED = {
    *("ambiguous", "uncertainty", "scale", "motions", "covariance", "translation", "rotation")
}

# What the methods made of one attempt.
Turn = Mapping[str, Timed]


def solve(method: str, attempts: Attempts) -> Callable[[LoopJob], Callable[[], Result]]:
    """Prepares jobs for a method: what is left to be called is what is timed."""
    fleet = attempts.fleet
    if method == "pnp":
        config = fleet.config("paper").loop_solver
        return lambda job: pnp_baseline.prepared(job, config, fleet)
    return LoopSolver(fleet.config(method).loop_solver, fleet).prepared


def solve_all(attempts: Attempts, methods: Sequence[str]) -> tuple[dict[str, Tally], list[Turn]]:
    """Every attempt by every method: the tallies, and attempt by attempt."""
    tallies = {method: Tally() for method in methods}
    prepare = {method: solve(method, attempts) for method in methods}
    jobs = {method: attempts.jobs["fast" if method == "fast" else "paper"] for method in methods}
    turns: list[Turn] = []
    for pair in dict.fromkeys(pair for found in jobs.values() for pair in found):
        turn: dict[str, Timed] = {}
        for method in methods:
            job = jobs[method].get(pair)
            T_true = None if job is None else attempts.fleet.true_loop(job)
            if job is None or T_true is None:
                continue
            turn[method] = timed(prepare[method](job))
            tallies[method].add(T_true, turn[method])
        turns.append(turn)
    return tallies, turns


def figures(tally: Tally, attempts: Attempts) -> dict[str, Any]:
    """The figures of one method; None where it has no loop, or no covariance."""
    honest = tally.nees(attempts.of_truth)
    estimated = [count for stage, count in tally.rejected.items() if stage in _ESTIMATED]
    return {
        "jobs": len(tally.times_ms),
        "accepted": len(tally.loops),
        "wrong": int(tally.wrong(attempts.limits).sum()),
        "rejected": dict(tally.rejected),
        "estimated": len(tally.loops) + sum(estimated),
        "within_nees_22_5": None if honest is None else int((honest <= NEES_LIMIT).sum()),
        "beyond_nees_22_5": None if honest is None else int((honest > NEES_LIMIT).sum()),
        **error_figures(tally),
        **nees_figures(honest),
        "nees_mean_without_truth": mean(tally.nees()),
        "nees_analytic_mean": mean(tally.nees(attempts.of_truth, "analytic_covariance")),
        "nees_analytic_mean_without_truth": mean(tally.nees(None, "analytic_covariance")),
        **time_figures(tally.times_ms),
        "stage_ms_mean": stage_figures(tally.stages_ms),
    }


def mean(values: Array | None) -> float | None:
    """The mean, if there is one."""
    return None if values is None else rounded(values.mean())


def compared(turns: Iterable[Turn]) -> dict[str, float | int | None]:
    """Fast against the paper on the attempts that both made: loops, and the median speed-up."""
    both = [turn for turn in turns if {"paper", "fast"} <= turn.keys()]
    loops = {
        method: sum(isinstance(turn[method].result, core.LoopEstimate) for turn in both)
        for method in ("paper", "fast")
    }
    ratios = [turn["paper"].ms / turn["fast"].ms for turn in both]
    return {
        "jobs": len(both),
        "accepted": rounded(loops["fast"] / loops["paper"]) if loops["paper"] else None,
        "speedup_median": rounded(np.median(ratios)) if ratios else None,
    }


def measure(data: Path, scenarios: Iterable[str], methods: Sequence[str]) -> dict[str, Any]:
    """All figures of the claim; a scenario whose recording is not there is left out."""
    results: dict[str, Any] = {}
    over_paper: dict[str, Any] = {}
    for name in scenarios:
        make, recordings = SCENARIOS[name]
        missing = [str(data / one) for one in recordings if not (data / one).is_dir()]
        if missing:
            sys.stderr.write(f"{name} is left out: needs {' and '.join(missing)}\n")
            continue
        attempts = make(data)
        tallies, turns = solve_all(attempts, methods)
        results[name] = {method: figures(tally, attempts) for method, tally in tallies.items()}
        over_paper[name] = compared(turns)
        sys.stderr.write(f"{name}: {json.dumps(results[name])}\n")
    return {
        "benchmark": "loop_accuracy",
        "machine": platform.processor() or platform.machine(),
        "isa": core.best_instruction_set().name.lower(),
        "fast_over_paper": over_paper,
        **results,
    }


def main() -> int:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the recordings")
    parser.add_argument(
        "--scenarios", nargs="+", choices=SCENARIOS, default=list(DEFAULT_SCENARIOS)
    )
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--json", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    # One thread, so that its CPU time is all the time.
    cv2.setNumThreads(1)
    made = measure(arguments.data, arguments.scenarios, arguments.methods)
    text = json.dumps(made, indent=2) + "\n"
    sys.stdout.write(text)
    if arguments.json:
        arguments.json.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
