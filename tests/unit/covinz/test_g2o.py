"""A written map read back is the same graph, and g2o's error agrees with ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from covinz import frames
from covinz.g2o import information_to_g2o, write_g2o
from covinz.types import Array, KeyframeId, MapSnapshot, MapSummary, SegmentId

SESSIONS = ("01ARZ3NDEKTSV4RRFFQ69G5FAV", "01BX5ZZKBKACTAV9WEVGEMMVRZ")

Graph = tuple[dict[int, Array], list[tuple[int, int, Array, Array]]]


def read_g2o(path: Path) -> Graph:
    """Vertices (7,) and edges (from, to, pose (7,), information (6, 6)) of a 3D file."""
    vertices: dict[int, Array] = {}
    edges: list[tuple[int, int, Array, Array]] = []
    for line in path.read_text().splitlines():
        words = line.split()
        if not words or words[0] == "#":
            continue
        if words[0] == "VERTEX_SE3:QUAT":
            vertices[int(words[1])] = np.array(words[2:], dtype=float)
            assert len(words) == 9
        elif words[0] == "EDGE_SE3:QUAT":
            upper = np.zeros((6, 6))
            upper[np.triu_indices(6)] = np.array(words[10:], dtype=float)
            information = upper + np.triu(upper, 1).T
            pose = np.array(words[3:10], dtype=float)
            edges.append((int(words[1]), int(words[2]), pose, information))
        else:
            raise AssertionError(f"unexpected line {line!r}")
    return vertices, edges


def g2o_error(T_measured: Array, T_from_to: Array) -> Array:
    """Error of an edge as g2o defines it: translation, then vector part of the quaternion."""
    delta = frames.inverse(T_measured) @ T_from_to
    return frames.pose_from_transform(delta)[:6]


def snapshot(seed: int = 1) -> MapSnapshot:
    rng = np.random.default_rng(seed)
    ids = [KeyframeId("agent0", SESSIONS[0], s) for s in (0, 1, 2)]
    ids += [KeyframeId("agent1", SESSIONS[1], s) for s in (0, 2)]
    poses = frames.transform(frames.so3_exp(rng.normal(size=(5, 3))), rng.normal(size=(5, 3)))
    ends = np.array([[0, 1], [2, 4], [1, 2], [3, 4]])
    factor = rng.normal(size=(4, 6, 6))
    return MapSnapshot(
        summary=MapSummary(SESSIONS[0], 7, tuple(SegmentId("agent0", s) for s in SESSIONS), 5, 1),
        keyframes=tuple(ids),
        stamps_ns=np.arange(5),
        T_map_body=poses,
        T_odom_body=poses,
        edge_from=ends[:, 0],
        edge_to=ends[:, 1],
        T_from_to=frames.inverse(poses[ends[:, 0]]) @ poses[ends[:, 1]],
        information=factor @ np.swapaxes(factor, 1, 2) + np.eye(6),
        is_loop=np.array([False, True, False, False]),
    )


def test_round_trip(tmp_path: Path) -> None:
    written = snapshot()
    write_g2o(tmp_path / "map.g2o", written)
    vertices, edges = read_g2o(tmp_path / "map.g2o")
    assert list(vertices) == [0, 1, 2, 3, 4]
    read = frames.transform_from_pose(np.array(list(vertices.values())))
    assert np.allclose(read, written.T_map_body)
    assert [(a, b) for a, b, _, _ in edges] == [(0, 1), (1, 2), (3, 4), (2, 4)]
    for edge, index in zip(edges, (0, 2, 3, 1), strict=True):
        assert np.allclose(frames.transform_from_pose(edge[2]), written.T_from_to[index])
        assert np.allclose(edge[3], information_to_g2o(written.information[index]))


def test_comments_name_the_keyframes_of_the_vertices(tmp_path: Path) -> None:
    write_g2o(tmp_path / "map.g2o", snapshot())
    comments = [line for line in (tmp_path / "map.g2o").read_text().splitlines() if line[0] == "#"]
    assert comments == [
        f"# map {SESSIONS[0]}, revision 7",
        f"# vertices 0 to 2: agent0/{SESSIONS[0]}, keyframes from 0 on",
        f"# vertices 3 to 3: agent1/{SESSIONS[1]}, keyframes from 0 on",
        f"# vertices 4 to 4: agent1/{SESSIONS[1]}, keyframes from 2 on",
        "# 3 edges of odometry",
        "# 1 edges of loops",
    ]


def test_the_cost_of_a_small_error_is_the_same_in_both_conventions() -> None:
    graph = snapshot()
    step = 1e-4 * np.random.default_rng(3).normal(size=(4, 6))
    T_from_to = graph.T_from_to @ frames.transform(frames.so3_exp(step[:, :3]), step[:, 3:])
    for T, measured, ours in zip(T_from_to, graph.T_from_to, graph.information, strict=True):
        error, theirs = frames.local_error(measured, T), g2o_error(measured, T)
        cost = theirs @ information_to_g2o(ours) @ theirs
        assert cost == pytest.approx(error @ ours @ error, rel=1e-6)


def test_a_single_vertex_makes_a_file(tmp_path: Path) -> None:
    whole = snapshot()
    alone = MapSnapshot(
        whole.summary,
        whole.keyframes[:1],
        whole.stamps_ns[:1],
        whole.T_map_body[:1],
        whole.T_odom_body[:1],
        whole.edge_from[:0],
        whole.edge_to[:0],
        whole.T_from_to[:0],
        whole.information[:0],
        whole.is_loop[:0],
    )
    write_g2o(tmp_path / "map.g2o", alone)
    vertices, edges = read_g2o(tmp_path / "map.g2o")
    assert (len(vertices), len(edges)) == (1, 0)


@pytest.mark.data
def test_the_reader_reads_published_graphs_as_it_reads_ours(recorded_data: Path) -> None:
    """The small reader above is no private dialect: it parses a public file as well."""
    vertices, edges = read_g2o(recorded_data / "posegraphs" / "single" / "sphere2500.g2o")
    assert (len(vertices), len(edges)) == (2500, 4949)
    assert all(np.linalg.eigvalsh(edge[3]).min() > 0 for edge in edges[:50])
