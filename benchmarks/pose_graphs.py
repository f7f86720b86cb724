"""Pose graphs to measure on, and the two solvers that are compared on them.

The reference is Ceres, in an executable of its own that the build of the core's tests makes
(core/tests/ceres_pose_graph_main.cc); both solvers' times are CPU time of one thread.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import covinz_core
import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.frames import Array
from services.optimizer import pose_graph

CERES = Path(__file__).resolve().parents[1] / "core" / "build" / "tests" / "ceres_pose_graph"
NUM_RUNS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Arguments of `optimize_pose_graph`; node 0 is fixed."""

    T_map_body: Array
    edge_from: NDArray[np.int64]
    edge_to: NDArray[np.int64]
    T_from_to: Array
    information: Array
    robust: NDArray[np.bool_]

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Node 0 alone."""
        first: NDArray[np.bool_] = np.arange(len(self.T_map_body)) == 0
        return first


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What a solver came to; `cpu_ms` is the median of `NUM_RUNS` runs."""

    T_map_body: Array
    cost: float
    iterations: int
    converged: bool
    cpu_ms: float


Solver = Callable[[Problem, float, float], Solution]


def of_graph(graph: pose_graph.PoseGraph, T_map_body: Array) -> Problem:
    """A map's pose graph from a start (N, 4, 4)."""
    return Problem(
        T_map_body,
        graph.edge_from,
        graph.edge_to,
        graph.T_from_to,
        graph.information,
        graph.is_loop,
    )


def read_g2o(paths: Iterable[Path]) -> Problem:
    """The 3D pose graph of one or more g2o files, every edge without a robust loss.

    g2o's rotation error is half the rotation vector (covinz/g2o.py); the information is converted.
    """
    vertices: dict[int, list[float]] = {}
    edges: list[list[float]] = []
    ends: list[tuple[int, int]] = []
    for path in paths:
        for line in path.read_text().splitlines():
            kind, *rest = line.split() or [""]
            if kind == "VERTEX_SE3:QUAT":
                vertices[int(rest[0])] = [float(word) for word in rest[1:]]
            elif kind == "EDGE_SE3:QUAT":
                ends.append((int(rest[0]), int(rest[1])))
                edges.append([float(word) for word in rest[2:]])
    row = {key: index for index, key in enumerate(vertices)}
    numbers = np.array(edges)
    between = np.array([(row[a], row[b]) for a, b in ends], dtype=np.int64)
    return Problem(
        frames.transform_from_pose(np.array(list(vertices.values()))),
        between[:, 0].copy(),
        between[:, 1].copy(),
        frames.transform_from_pose(numbers[:, :7]),
        _information(numbers[:, 7:]),
        np.zeros(len(edges), dtype=bool),
    )


def ours(problem: Problem, cauchy_scale: float, start_factor: float) -> Solution:
    """The core's solver."""
    options = covinz_core.PoseGraphOptions(
        cauchy_scale=cauchy_scale, cauchy_start_factor=start_factor
    )
    times = []
    for _ in range(NUM_RUNS):
        started = time.process_time()
        result = covinz_core.optimize_pose_graph(
            problem.T_map_body,
            problem.fixed,
            problem.edge_from,
            problem.edge_to,
            problem.T_from_to,
            problem.information,
            problem.robust,
            options,
        )
        times.append(1e3 * (time.process_time() - started))
    return Solution(
        np.asarray(result.T_map_body),
        result.final_cost,
        result.num_iterations,
        result.converged,
        float(np.median(times)),
    )


def ceres(problem: Problem, cauchy_scale: float, start_factor: float) -> Solution:
    """Ceres, both Cauchy scales one after the other.

    Raises:
        FileNotFoundError: If the executable has not been built (`make core-tests`).
    """
    iterations, cpu_ms = 0, 0.0
    for factor in sorted({start_factor, 1.0}, reverse=True):
        runs = [_ceres_once(problem, factor * cauchy_scale) for _ in range(NUM_RUNS)]
        iterations += runs[0].iterations
        cpu_ms += float(np.median([run.cpu_ms for run in runs]))
        problem = replace(problem, T_map_body=runs[0].T_map_body)
    return replace(runs[0], iterations=iterations, cpu_ms=cpu_ms)


def compared(problem: Problem, cauchy_scale: float, start_factor: float) -> dict[str, object]:
    """Both solvers on one problem."""
    columns: dict[str, object] = {
        "keyframes": len(problem.T_map_body),
        "edges": len(problem.edge_to),
        "robust_edges": int(problem.robust.sum()),
    }
    cpu_ms = {}
    solvers: dict[str, Solver] = {"ours": ours, "ceres": ceres}
    for name, solver in solvers.items():
        solution = solver(problem, cauchy_scale, start_factor)
        cpu_ms[name] = solution.cpu_ms
        columns[name] = {
            "cpu_ms": round(solution.cpu_ms, 2),
            "iterations": solution.iterations,
            "converged": solution.converged,
            "cost": solution.cost,
        }
    columns["times_faster"] = round(cpu_ms["ceres"] / cpu_ms["ours"], 1)
    return columns


def _ceres_once(problem: Problem, cauchy_scale: float) -> Solution:
    sizes = np.array([len(problem.T_map_body), len(problem.edge_to)], dtype=np.int64)
    parts = (
        np.array([cauchy_scale, 100.0]),
        sizes,
        np.ascontiguousarray(problem.T_map_body),
        problem.fixed.astype(np.uint8),
        problem.edge_from,
        problem.edge_to,
        np.ascontiguousarray(problem.T_from_to),
        np.ascontiguousarray(problem.information),
        problem.robust.astype(np.uint8),
    )
    data = b"".join(part.tobytes() for part in parts)
    out = np.frombuffer(
        subprocess.run([CERES], input=data, stdout=subprocess.PIPE, check=True).stdout
    )
    T_map_body = out[5:].reshape(-1, 4, 4).copy()
    return Solution(T_map_body, float(out[1]), int(out[2]), bool(out[3]), 1e3 * float(out[4]))


def _information(upper: Array) -> Array:
    """(M, 6, 6) of [rotation vector, translation] from g2o's upper triangles."""
    matrix = np.zeros((len(upper), 6, 6))
    rows, columns = np.triu_indices(6)
    matrix[:, rows, columns] = upper
    matrix[:, columns, rows] = upper
    order = [3, 4, 5, 0, 1, 2]
    scale = np.array([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])
    result: Array = matrix[:, order, :][:, :, order] * scale[:, None] * scale
    return np.ascontiguousarray(result)
