"""Claim: a map that is a function of log and loops (decision 0003) costs no more than it may.

Generated fleets of 5 robots with loops of each pair, 10 % of them wrong. Measured, in CPU time of
one thread: the map from scratch against a warm start from the previous map with one loop more.
Measured too, as position RMSE after alignment, also with odometry worse than configured: what each
decision is worth. Prints JSON.

    (`solver`: the core's pose graph solver against Ceres, benchmarks/pose_graphs.py)

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.map_from_scratch [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.pose_graphs import compared, of_graph
from covinz.config import OdometryNoise, OptimizerConfig
from covinz.frames import Array
from services.optimizer import optimisation, pose_graph
from services.optimizer.alignment import align_segments
from services.optimizer.components import Component
from tests.fleets import Fleet, aligned_rmse, make_fleet, only_component

CONFIG = OptimizerConfig()
NUM_AGENTS = 5
SEEDS = range(5)


def cpu_ms(work: Callable[[], object]) -> float:
    """Median CPU time of three runs [ms]."""
    times = []
    for _ in range(3):
        started = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - started))
    return statistics.median(times)


def costs(num_keyframes: int, loops_per_pair: int) -> dict[str, object]:
    """Where the time goes for a map of this size, and what a warm start would take."""
    fleet = make_fleet(0, NUM_AGENTS, num_keyframes // NUM_AGENTS, loops_per_pair, 0.1)
    component = only_component(fleet)
    before = Component(component.segments, component.loops[:-1])
    previous = optimisation.optimise(before, CONFIG).T_map_body
    graph = pose_graph.build_graph(component, CONFIG)
    scratch = optimisation.optimise(component, CONFIG)
    start = optimisation.start_of(component, graph, CONFIG)

    def warm() -> None:
        now = pose_graph.build_graph(component, CONFIG)
        options = optimisation.pose_graph_options(without(cauchy_start_factor=1.0))
        optimisation.minimised(now, previous, options)

    return {
        "keyframes": component.num_keyframes,
        "loops": len(component.loops),
        "edges": len(graph.edge_to),
        "graph_ms": cpu_ms(lambda: pose_graph.build_graph(component, CONFIG)),
        "alignment_ms": cpu_ms(lambda: align_segments(component, pose_graph.noise_of(CONFIG))),
        "scratch_ms": cpu_ms(lambda: optimisation.optimise(component, CONFIG)),
        "scratch_iterations": scratch.iterations,
        "warm_ms": cpu_ms(warm),
        "rmse_m": rmse(fleet, scratch.T_map_body),
        "solver": compared(of_graph(graph, start), CONFIG.cauchy_scale, CONFIG.cauchy_start_factor),
    }


def rmse(fleet: Fleet, T_map_body: Array) -> float:
    """Against the truth [m]."""
    truth = np.array([fleet.T_world_body[kf.id] for kf in fleet.keyframes])
    return aligned_rmse(T_map_body, truth)


def without(**changes: object) -> OptimizerConfig:
    """The configuration with one decision undone."""
    return CONFIG.model_copy(update=changes)


def scaled_odometry(factor: float) -> OdometryNoise:
    """Odometry so many times worse than the default."""
    sigmas = CONFIG.odometry.model_dump()
    return OdometryNoise(**{name: factor * sigma for name, sigma in sigmas.items()})


def accuracy(config: OptimizerConfig, drift: float, wrong: float) -> dict[str, float]:
    """Median and worst RMSE of 3 robots x 200 keyframes with 6 loops a pair."""
    found = []
    for seed in SEEDS:
        fleet = make_fleet(seed, 3, 200, 6, wrong, scaled_odometry(drift))
        found.append(rmse(fleet, optimisation.optimise(only_component(fleet), config).T_map_body))
    return {"median_m": statistics.median(found), "worst_m": max(found)}


def measure() -> dict[str, object]:
    """All figures of decision 0003."""
    return {
        "benchmark": "map_from_scratch",
        "machine": platform.processor() or platform.machine(),
        "cost": [costs(n, loops) for n, loops in ((200, 3), (1000, 12), (2500, 27))],
        "accuracy": {
            f"drift x {drift}, wrong loops {wrong:.0%}": {
                name: accuracy(config, drift, wrong)
                for name, config in (
                    ("as decided", CONFIG),
                    ("without the wide start", without(cauchy_start_factor=1.0)),
                    ("Cauchy scale 1", without(cauchy_scale=1.0)),
                    ("information not shared", without(odometry=scaled_odometry(0.1**0.5))),
                )
            }
            for drift in (1, 3)
            for wrong in (0.0, 0.2)
        },
    }


def main() -> None:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    report = json.dumps(measure(), indent=2) + "\n"
    sys.stdout.write(report)
    if arguments.out:
        arguments.out.write_text(report)


if __name__ == "__main__":
    main()
