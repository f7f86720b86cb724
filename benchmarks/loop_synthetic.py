"""Claim: the fast profile is fast, a third as wrong as the paper's, and knows how wrong it is.

All methods solve the same generated problems (loop_problems.py), one after the other on each, so
that what disturbs the machine disturbs all of them. Times are CPU times of one thread, matching
included; `speedup_*` are medians, over the problems of `default` (ORB, 30 % wrong matches), of the
time of `paper` over that of `fast`: in all; with `fast` on SSE4.2 and POPCNT alone
(`speedup_portable_median`) and on what every x86-64 has (`speedup_no_popcnt_median`), while `paper`
keeps OpenCV's AVX2; and of what is left of both without matching. With `--older-cpu` also
`speedup_portable_older_cpu_median`: both on SSE4.2, as on a processor without AVX2, which this
program does by starting itself again with OpenCV told so.

A loop is right within 0.3 m and 3 degrees. `success` is the share of right ones among the loops
that were not rejected, `success_of_all` among all trials. NEES is 6 ideally, 22.5 its 99.9 %
quantile; `poselib`, a peer (loop_peers.py), has no covariance and so no NEES.

    python -m benchmarks.loop_synthetic [--trials N] [--conditions NAME ...] [--older-cpu]
        [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import covinz_core as core
import numpy as np

from benchmarks.loop_conditions import CONDITIONS, Condition
from benchmarks.loop_figures import (
    Limits,
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
from benchmarks.loop_peers import solve_poselib
from benchmarks.loop_problems import T_BODY_CAM, Array, LoopProblem, generate
from covinz import frames
from covinz.config import LoopSolverConfig
from services.loop_solver.solver import fast_loop_options, loop_options

_RIGHT = Limits(0.3, np.deg2rad(3))
# The condition of the speed-ups, and the methods that only it has.
_SPEED = "default"
_PORTABLE = "fast_portable"
_FORCED = {
    _PORTABLE: core.InstructionSet.SSE42,
    "fast_no_popcnt": core.InstructionSet.PORTABLE,
}
# What OpenCV dispatches beyond SSE4.2.
_OLDER_CPU = {"OPENCV_CPU_DISABLE": "AVX,FP16,AVX2,FMA3,AVX_512F,AVX512_COMMON,AVX512_SKX"}

Solver = Callable[[LoopProblem, Condition, int], Result]


def paper(problem: LoopProblem, condition: Condition, seed: int) -> Result:
    """The paper's pipeline as configured by default."""
    del condition
    return core.solve_loop(problem.query, problem.cand, loop_options(LoopSolverConfig(), seed))


def fast(
    problem: LoopProblem,
    condition: Condition,
    seed: int,
    instruction_set: core.InstructionSet | None = None,
) -> Result:
    """The fast profile as configured by default, told how accurate the odometry is."""
    options = fast_loop_options(LoopSolverConfig(), seed)
    if instruction_set is not None:
        options.instruction_set = instruction_set
    covariance = _motion_covariance(condition)
    query = core.LoopRig(problem.query, [core.RigMotion(1, 0, covariance)])
    cand = core.LoopRig(
        problem.cand, [core.RigMotion(1, 0, covariance), core.RigMotion(0, 2, covariance)]
    )
    return core.solve_loop_fast(query, cand, options)


def peer(problem: LoopProblem, condition: Condition, seed: int) -> Result:
    """PoseLib."""
    del condition
    return solve_poselib(problem, seed)


METHODS: Mapping[str, Solver] = {"paper": paper, "fast": fast, "poselib": peer}


def _motion_covariance(condition: Condition) -> Array:
    """Of the camera's motion, from the body's."""
    sigmas = np.repeat([condition.odometry_sigma_rad, condition.odometry_sigma_m], 3)
    to_camera = frames.adjoint(frames.inverse(T_BODY_CAM))
    covariance: Array = to_camera @ np.diag(sigmas**2) @ to_camera.T
    return (covariance + covariance.T) / 2


def figures(tally: Tally) -> dict[str, Any]:
    """The figures of one method under one condition; None where no loop was found."""
    trials, accepted = len(tally.times_ms), len(tally.loops)
    right = accepted - int(tally.wrong(_RIGHT).sum())
    return {
        "trials": trials,
        "accepted": accepted,
        "rejected": dict(tally.rejected),
        "success": rounded(right / accepted) if accepted else None,
        "success_of_all": rounded(right / trials),
        **error_figures(tally),
        **nees_figures(tally.nees()),
        **time_figures(tally.times_ms),
        "stage_ms_mean": stage_figures(tally.stages_ms),
    }


def solve_all(
    condition: Condition, methods: Mapping[str, Solver], trials: int
) -> tuple[dict[str, Tally], list[dict[str, Timed]]]:
    """Every problem by every method: the tallies, and problem by problem."""
    tallies = {name: Tally() for name in methods}
    turns = []
    for seed in range(trials):
        problem = generate(condition, seed)
        turn = {
            name: timed(partial(solve, problem, condition, seed)) for name, solve in methods.items()
        }
        for name, attempt in turn.items():
            tallies[name].add(problem.T_cand_query, attempt)
        turns.append(turn)
    return tallies, turns


def speedups(turns: Sequence[Mapping[str, Timed]]) -> dict[str, float | None]:
    """How many times faster than the paper's the fast profile is, as medians over the problems."""

    def median(of_paper: Callable[[Timed], float], name: str) -> float | None:
        ratios = [
            of_paper(turn["paper"]) / of_paper(turn[name])
            for turn in turns
            if {"paper", name} <= turn.keys()
        ]
        return rounded(np.median(ratios)) if ratios else None

    return {
        "speedup_median": median(lambda attempt: attempt.ms, "fast"),
        "speedup_portable_median": median(lambda attempt: attempt.ms, _PORTABLE),
        "speedup_no_popcnt_median": median(lambda attempt: attempt.ms, "fast_no_popcnt"),
        "speedup_geometry_only_median": median(lambda a: a.without_matching_ms, "fast"),
    }


def measure(conditions: Sequence[str], methods: Sequence[str], trials: int) -> dict[str, Any]:
    """All figures of the claim."""
    results: dict[str, Any] = {}
    turns: list[dict[str, Timed]] = []
    for name in conditions:
        solvers = {method: METHODS[method] for method in methods}
        if name == _SPEED and "fast" in methods:
            for method, forced in _FORCED.items():
                if core.is_supported(forced):
                    solvers[method] = partial(fast, instruction_set=forced)
        tallies, solved = solve_all(CONDITIONS[name], solvers, trials)
        results[name] = {method: figures(tally) for method, tally in tallies.items()}
        turns = solved if name == _SPEED else turns
        sys.stderr.write(f"{name}: {json.dumps(results[name])}\n")
    return {
        "benchmark": "loop_synthetic",
        "machine": platform.processor() or platform.machine(),
        "isa": core.best_instruction_set().name.lower(),
        "trials": trials,
        "speedup_condition": _SPEED,
        **speedups(turns),
        "conditions": results,
    }


def main() -> int:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--conditions", nargs="+", choices=CONDITIONS, default=list(CONDITIONS))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--json", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    made = measure(arguments.conditions, arguments.methods, arguments.trials)
    text = json.dumps(made, indent=2) + "\n"
    sys.stdout.write(text)
    if arguments.json:
        arguments.json.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
