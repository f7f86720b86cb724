"""Claim: our pose graph solver reaches Ceres' minimum, or a lower one, in a fraction of its time.

Public graphs where they are at hand (`--data`, g2o files): least squares without a robust loss,
from the start in the file. Generated fleets with up to several loops per keyframe, as the fast loop
solver finds them, 10 % of them wrong: from scratch as the optimizer does it. CPU time of one
thread. Prints JSON.

    python -m benchmarks.pose_graph [--data FOLDER] [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from pathlib import Path

from benchmarks.pose_graphs import Problem, compared, of_graph, read_g2o
from covinz.config import OptimizerConfig
from services.optimizer import optimisation, pose_graph
from tests.fleets import make_fleet, only_component

CONFIG = OptimizerConfig()
DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "posegraphs"
# No robust loss: a scale that no residual comes near to.
PLAIN = 1e9
PUBLIC = {
    "sphere2500": ("single/sphere2500.g2o",),
    "smallGrid3D": ("single/smallGrid3D.g2o",),
}
# Robots, keyframes of each, loops of each pair of robots.
FLEETS = ((3, 208, 470), (5, 200, 200), (5, 500, 27), (5, 500, 270))


def fleet(num_agents: int, length: int, loops_per_pair: int) -> Problem:
    """A generated fleet from its canonical start."""
    component = only_component(make_fleet(0, num_agents, length, loops_per_pair, 0.1))
    graph = pose_graph.build_graph(component, CONFIG)
    return of_graph(graph, optimisation.start_of(component, graph, CONFIG))


def measure(data: Path) -> dict[str, object]:
    """Both solvers on all graphs."""
    public = {
        name: compared(read_g2o(data / path for path in paths), PLAIN, 1.0)
        for name, paths in PUBLIC.items()
        if all((data / path).exists() for path in paths)
    }
    fleets = {
        f"{agents} x {length} keyframes, {loops} loops a pair": compared(
            fleet(agents, length, loops), CONFIG.cauchy_scale, CONFIG.cauchy_start_factor
        )
        for agents, length, loops in FLEETS
    }
    return {
        "benchmark": "pose_graph",
        "machine": platform.processor() or platform.machine(),
        "public": public,
        "fleets": fleets,
    }


def main() -> None:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA, help="folder of public g2o files")
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    report = json.dumps(measure(arguments.data), indent=2) + "\n"
    sys.stdout.write(report)
    if arguments.out:
        arguments.out.write_text(report)


if __name__ == "__main__":
    main()
