"""Pose graph optimisation through the bindings: known small problems and public data sets."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import covinz_core as core
import numpy as np
import pytest
from numpy.typing import NDArray

DATA = Path(os.environ.get("COVINZ_DATA", Path(__file__).resolve().parents[4] / "shared" / "data"))

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Graph:
    """Arguments of optimize_pose_graph, plain odometry losses."""

    T_map_body: Array
    edge_from: NDArray[np.int64]
    edge_to: NDArray[np.int64]
    T_from_to: Array
    information: Array

    def optimize(
        self, options: core.PoseGraphOptions | None = None, robust: bool = False
    ) -> core.PoseGraphResult:
        fixed = np.zeros(len(self.T_map_body), dtype=bool)
        fixed[0] = True
        return core.optimize_pose_graph(
            self.T_map_body,
            fixed,
            self.edge_from,
            self.edge_to,
            self.T_from_to,
            self.information,
            np.full(len(self.edge_from), robust),
            options or core.PoseGraphOptions(),
        )


def translation(x: float, y: float = 0.0, z: float = 0.0) -> Array:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def line_graph() -> Graph:
    """Two nodes 1 m apart by one edge of weight 4, and 1.5 m apart by one of weight 1."""
    return Graph(
        T_map_body=np.stack([np.eye(4), np.eye(4)]),
        edge_from=np.array([0, 0]),
        edge_to=np.array([1, 1]),
        T_from_to=np.stack([translation(1.0), translation(1.5)]),
        information=np.stack([4.0 * np.eye(6), np.eye(6)]),
    )


def rigid(values: list[float]) -> Array:
    """Transform of g2o's x y z qx qy qz qw."""
    x, y, z, w = np.array(values[3:7]) / np.linalg.norm(values[3:7])
    T = translation(*values[:3])
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return T


def read_g2o(path: Path) -> Graph:
    nodes: dict[int, Array] = {}
    edges: list[tuple[int, int, Array, Array]] = []
    rotation_first = [3, 4, 5, 0, 1, 2]
    for line in path.read_text().splitlines():
        tag, *fields = line.split()
        if tag == "VERTEX_SE3:QUAT":
            nodes[int(fields[0])] = rigid([float(v) for v in fields[1:]])
        elif tag == "EDGE_SE3:QUAT":
            values = [float(v) for v in fields[2:]]
            W = np.zeros((6, 6))
            W[np.triu_indices(6)] = values[7:]
            W = W + np.triu(W, 1).T
            W = W[np.ix_(rotation_first, rotation_first)]
            edges.append((int(fields[0]), int(fields[1]), rigid(values), W))
    return Graph(
        T_map_body=np.stack([nodes[i] for i in range(len(nodes))]),
        edge_from=np.array([edge[0] for edge in edges]),
        edge_to=np.array([edge[1] for edge in edges]),
        T_from_to=np.stack([edge[2] for edge in edges]),
        information=np.stack([edge[3] for edge in edges]),
    )


def chordal_cost(graph: Graph, T_map_body: Array) -> float:
    """Half chi^2 with the rotation error 2 vec(q), in which the published costs are counted."""
    T_estimated = np.linalg.inv(T_map_body[graph.edge_from]) @ T_map_body[graph.edge_to]
    E = np.linalg.inv(graph.T_from_to) @ T_estimated
    w = 0.5 * np.sqrt(1.0 + np.trace(E[:, :3, :3], axis1=1, axis2=2))
    skew = np.stack(
        [E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]], axis=1
    )
    error = np.concatenate([skew / (2.0 * w[:, None]), E[:, :3, 3]], axis=1)
    return 0.5 * float(np.einsum("mi,mij,mj->", error, graph.information, error))


def test_weighted_mean_of_two_edges() -> None:
    result = line_graph().optimize(core.PoseGraphOptions(function_tolerance=0.0))
    assert result.converged
    assert result.initial_cost == pytest.approx(0.5 * (4.0 * 1.0 + 1.5**2))
    assert result.final_cost == pytest.approx(0.1)
    assert result.T_map_body.shape == (2, 4, 4)
    np.testing.assert_allclose(result.T_map_body[1], translation(1.1), atol=1e-8)
    np.testing.assert_allclose(result.edge_chi2, [0.04, 0.16], atol=1e-8)


def test_robust_edges_take_the_cauchy_scale() -> None:
    result = line_graph().optimize(core.PoseGraphOptions(cauchy_scale=2.0), robust=True)
    expected = 0.5 * 4.0 * (np.log1p(4.0 / 4.0) + np.log1p(2.25 / 4.0))
    assert result.initial_cost == pytest.approx(expected)


def test_same_input_same_bits() -> None:
    first, second = line_graph().optimize(), line_graph().optimize()
    assert first.T_map_body.tobytes() == second.T_map_body.tobytes()
    assert first.edge_chi2.tobytes() == second.edge_chi2.tobytes()


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("edge_to", np.array([1, 2]), "edge 1 names node 2 of 2"),
        ("edge_to", np.array([1]), "`edge_to` has length 1, expected 2"),
        ("T_from_to", np.stack([np.eye(4), np.full((4, 4), np.nan)]), "edge 1 is not finite"),
        ("information", -np.stack([np.eye(6), np.eye(6)]), "not symmetric positive definite"),
        ("T_map_body", np.stack([np.eye(4), 2.0 * np.eye(4)]), "node 1 is not a rigid transform"),
        ("T_map_body", np.stack([np.eye(4)] * 3), "`fixed`|node 2 is not connected"),
    ],
)
def test_malformed_input_is_a_value_error(field: str, value: Array, message: str) -> None:
    arguments = {name: getattr(line_graph(), name) for name in Graph.__slots__}
    with pytest.raises(ValueError, match=message):
        Graph(**(arguments | {field: value})).optimize()


def test_options_are_checked() -> None:
    with pytest.raises(ValueError, match="cauchy_scale"):
        core.PoseGraphOptions(cauchy_scale=-1.0)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "cost", "published_cost"),
    [
        ("smallGrid3D", 516.947, 512.699),
        pytest.param("sphere2500", 675.681, 675.608, marks=pytest.mark.slow),
    ],
)
def test_public_data_sets_reach_their_known_cost(
    name: str, cost: float, published_cost: float
) -> None:
    """Our minimum counts rotation errors as angles, the published one as 2 sin(angle / 2).

    Counted in the published way, our minimum must be as low but for the difference of the two.
    """
    path = DATA / "posegraphs" / "single" / f"{name}.g2o"
    if not path.exists():
        pytest.skip(f"no recorded data at {path}; COVINZ_DATA may name another folder")
    graph = read_g2o(path)
    result = graph.optimize()
    assert result.converged
    assert result.final_cost == pytest.approx(cost, rel=1e-5)
    assert chordal_cost(graph, result.T_map_body) == pytest.approx(published_cost, rel=2e-4)
