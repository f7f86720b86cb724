"""Claim: neighbours chosen by geometry find more loops, and more exact ones, than the next ones.

Profile `fast` solves the same pairs with rigs of the nearest keyframes (`index`, the paper's rule)
and of those that geometry chooses (decision 0021): on generated tracks (rig_tracks.py; a loop is
right within 0.3 m and 3 degrees), and on redkitchen with keyframes at 0.05, 0.15 and 0.3 m (or
rad), up to 300 pairs each (right within 0.5 m and 10 degrees). `sigma_m` is the median of the
predicted standard deviation of the translation.

    python -m benchmarks.rig_neighbours [--trials N] [--data FOLDER] [--json FILE]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import covinz_core as core
import numpy as np

from benchmarks.fleet import Fleet, gather
from benchmarks.loop_attempts import DATA, read_scenario
from benchmarks.loop_figures import (
    Limits,
    Tally,
    error_figures,
    nees_figures,
    rounded,
    time_figures,
    timed,
)
from benchmarks.loop_jobs import Pair, jobs_of, near_pairs
from benchmarks.rig_tracks import TRACKS, generate
from covinz.config import KeyframeSelectionConfig, merge
from covinz.scenario import TumAgent
from covinz.types import Array
from services.loop_solver.solver import LoopSolver

# Sizes besides the paper's, on the recording only: query, candidate.
_SIZES = ((2, 3), (3, 3), (2, 4), (3, 5))
_RULES = ("index", "geometry")
_SPACINGS_M = (0.05, 0.15, 0.3)
_FRAMES = ((0, 399), (300, 699), (600, 999))
_MAX_PAIRS = 300
# Redkitchen's ground truth of a pair, as in loop_attempts.py: NEES counts it in.
_OF_TRUTH = np.diag(np.repeat([np.deg2rad(1.2) ** 2 / 3, 0.04**2 / 3], 3))


def with_rigs(fleet: Fleet, rule: str, sizes: tuple[int, int]) -> Fleet:
    """The fleet with another way to form rigs."""
    rigs = {"neighbours": rule, "query_size": sizes[0], "cand_size": sizes[1]}
    settings = merge(fleet.settings, {"place_recognition": {"rigs": rigs}})
    return dataclasses.replace(fleet, settings=settings)


def solve(fleet: Fleet, pairs: set[Pair], tally: Tally) -> None:
    """Make the jobs of the pairs and solve every one."""
    solver = LoopSolver(fleet.config("fast").loop_solver, fleet)
    for job in jobs_of(fleet, pairs, "fast"):
        T_true = fleet.true_loop(job)
        if T_true is not None:
            tally.add(T_true, timed(solver.prepared(job)))


def figures(tally: Tally, limits: Limits, of_truth: Array | None = None) -> dict[str, Any]:
    """Counts, errors, NEES and times."""
    sigmas_m = [
        np.sqrt(np.trace(loop.covariance[3:, 3:]))
        for loop in tally.loops
        if isinstance(loop, core.LoopEstimate)
    ]
    return {
        "jobs": len(tally.times_ms),
        "accepted": len(tally.loops),
        "wrong": int(tally.wrong(limits).sum()),
        **error_figures(tally),
        **nees_figures(tally.nees(of_truth)),
        "sigma_m": rounded(np.median(sigmas_m)) if sigmas_m else None,
        **time_figures(tally.times_ms),
        "rejected": dict(tally.rejected),
    }


def measure_tracks(trials: int) -> dict[str, Any]:
    """Each kind of track by both rules."""
    results: dict[str, Any] = {}
    for name, track in TRACKS.items():
        tallies = {rule: Tally() for rule in _RULES}
        for seed in range(trials):
            fleet, query, cand = generate(track, seed)
            for rule, tally in tallies.items():
                solve(with_rigs(fleet, rule, (2, 3)), {frozenset((query, cand))}, tally)
        limits = Limits(0.3, np.deg2rad(3))
        results[name] = {rule: figures(tally, limits) for rule, tally in tallies.items()}
    return results


def measure_recording(data: Path) -> dict[str, Any]:
    """Redkitchen at several spacings of keyframes; other sizes of rigs at the usual one."""
    scenario = read_scenario("redkitchen", data)
    base = next(agent for agent in scenario.agents if isinstance(agent, TumAgent))
    results: dict[str, Any] = {}
    for spacing_m in _SPACINGS_M:
        keyframes = KeyframeSelectionConfig(translation_m=spacing_m, rotation_rad=spacing_m)
        robots = tuple(
            base.model_copy(update={"id": f"agent{i}", "frames": part, "keyframes": keyframes})
            for i, part in enumerate(_FRAMES)
        )
        fleet = gather(scenario.model_copy(update={"agents": robots}))
        sizes = _SIZES if spacing_m == 0.15 else _SIZES[:1]
        results[f"{spacing_m:g}"] = by_rule_and_size(fleet, _some(near_pairs(fleet)), sizes)
    return results


def by_rule_and_size(
    fleet: Fleet, pairs: set[Pair], sizes: Iterable[tuple[int, int]]
) -> Mapping[str, Any]:
    """The same pairs with different rigs."""
    results = {}
    for size in sizes:
        for rule in _RULES:
            tally = Tally()
            solve(with_rigs(fleet, rule, size), pairs, tally)
            name = f"{rule}_{size[0]}x{size[1]}"
            results[name] = figures(tally, Limits(0.5, np.deg2rad(10)), _OF_TRUTH)
    return results


def _some(pairs: set[Pair]) -> set[Pair]:
    """Every n-th pair, so that they are not many more than `_MAX_PAIRS`."""
    in_order = sorted(pairs, key=lambda pair: sorted(pair))
    return set(in_order[:: max(1, len(in_order) // _MAX_PAIRS)])


def main() -> int:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=40, help="generated runs of each kind")
    parser.add_argument("--data", type=Path, default=DATA, help="folder that holds redkitchen/")
    parser.add_argument("--json", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    report: dict[str, Any] = {"benchmark": "rig_neighbours"}
    if arguments.trials > 0:
        report["tracks"] = measure_tracks(arguments.trials)
    if (arguments.data / "redkitchen").is_dir():
        report["redkitchen"] = measure_recording(arguments.data)
    else:
        sys.stderr.write(f"without redkitchen: needs {arguments.data / 'redkitchen'}\n")
    text = json.dumps(report, indent=2) + "\n"
    sys.stdout.write(text)
    if arguments.json:
        arguments.json.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
