"""Claim: the fast profile is fast, a third as wrong as the paper's, and knows how wrong it is.

Both solve the same generated problems (loop_problems.py) in the same run; times are CPU times of
one thread, matching included. A loop counts as right within 0.3 m and 3 degrees. NEES is 6 ideally;
22.5 is its 99.9 % quantile.

    python -m benchmarks.loop_synthetic [--trials N] [--conditions NAME ...] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import covinz_core as core
import numpy as np

from benchmarks.loop_problems import CONDITIONS, T_BODY_CAM, Array, Condition, LoopProblem, generate
from covinz import frames
from covinz.config import LoopSolverConfig
from covinz.evaluation import nees, relative_errors
from services.loop_solver.solver import loop_options

_RIGHT_M = 0.3
_RIGHT_RAD = np.deg2rad(3)
_NEES_LIMIT = 22.5

Result = core.LoopEstimate | core.LoopRejection
Solver = Callable[[LoopProblem, Condition, int], Result]


def paper(problem: LoopProblem, condition: Condition, seed: int) -> Result:
    """The paper's pipeline as configured by default."""
    del condition
    return core.solve_loop(problem.query, problem.cand, loop_options(LoopSolverConfig(), seed))


def fast(problem: LoopProblem, condition: Condition, seed: int) -> Result:
    """The fast profile, told the accuracy of the odometry as a front-end would."""
    options = core.FastLoopOptions()
    options.seed = seed
    covariance = _motion_covariance(condition)
    query = core.LoopRig(problem.query, [core.RigMotion(1, 0, covariance)])
    cand = core.LoopRig(
        problem.cand, [core.RigMotion(1, 0, covariance), core.RigMotion(0, 2, covariance)]
    )
    return core.solve_loop_fast(query, cand, options)


METHODS: dict[str, Solver] = {"paper": paper, "fast": fast}


def _motion_covariance(condition: Condition) -> Array:
    """Of the camera's motion, from the body's."""
    sigmas = np.repeat([condition.odometry_sigma_rad, condition.odometry_sigma_m], 3)
    to_camera = frames.adjoint(frames.inverse(T_BODY_CAM))
    covariance: Array = to_camera @ np.diag(sigmas**2) @ to_camera.T
    return (covariance + covariance.T) / 2


@dataclass(slots=True)
class Record:
    """What one method did under one condition."""

    trials: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    T_true: list[Array] = field(default_factory=list)
    T_estimate: list[Array] = field(default_factory=list)
    covariance: list[Array] = field(default_factory=list)
    times_ms: list[float] = field(default_factory=list)

    def add(self, problem: LoopProblem, result: Result, time_ms: float) -> None:
        """One trial."""
        self.trials += 1
        self.times_ms.append(time_ms)
        if isinstance(result, core.LoopRejection):
            self.rejected[result.stage] += 1
            return
        self.T_true.append(problem.T_cand_query)
        self.T_estimate.append(result.T_cand_query)
        self.covariance.append(result.covariance)

    def summary(self) -> dict[str, Any]:
        """The figures of the claim."""
        figures: dict[str, Any] = {
            "trials": self.trials,
            "accepted": len(self.T_true),
            "rejected": dict(self.rejected),
            "ms_median": float(np.median(self.times_ms)),
            "ms_p95": float(np.quantile(self.times_ms, 0.95)),
        }
        if not self.T_true:
            return figures
        T_true, T_estimate = np.array(self.T_true), np.array(self.T_estimate)
        errors = relative_errors(T_true, T_estimate)
        right = (errors.translation_m < _RIGHT_M) & (errors.rotation_rad < _RIGHT_RAD)
        values = nees(T_true, T_estimate, np.array(self.covariance))
        return figures | {
            "success": float(right.mean()),
            "t_err_median_m": float(np.median(errors.translation_m)),
            "t_err_p95_m": float(np.quantile(errors.translation_m, 0.95)),
            "r_err_median_deg": float(np.rad2deg(np.median(errors.rotation_rad))),
            "nees_mean": float(values.mean()),
            "nees_median": float(np.median(values)),
            "nees_over_22_5": float((values > _NEES_LIMIT).mean()),
        }


def measure(conditions: Sequence[str], methods: Sequence[str], trials: int) -> dict[str, Any]:
    """All methods on the same problems of each condition."""
    results: dict[str, Any] = {}
    speedups = []
    for name in conditions:
        records = {method: Record() for method in methods}
        for seed in range(trials):
            problem = generate(CONDITIONS[name], seed)
            for method, record in records.items():
                begin = time.thread_time()
                result = METHODS[method](problem, CONDITIONS[name], seed)
                record.add(problem, result, 1e3 * (time.thread_time() - begin))
        results[name] = {method: record.summary() for method, record in records.items()}
        if {"paper", "fast"} <= records.keys():
            speedups.append(
                results[name]["paper"]["ms_median"] / results[name]["fast"]["ms_median"]
            )
        print(name, json.dumps(results[name]), file=sys.stderr, flush=True)
    return {
        "benchmark": "loop_synthetic",
        "machine": platform.processor() or platform.machine(),
        "conditions": results,
        "speedup_median": float(np.median(speedups)) if speedups else None,
    }


def main() -> None:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--conditions", nargs="+", choices=CONDITIONS, default=list(CONDITIONS))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    text = json.dumps(measure(arguments.conditions, arguments.methods, arguments.trials), indent=2)
    if arguments.json:
        arguments.json.write_text(text + "\n")
    else:
        print(text)


if __name__ == "__main__":
    main()
