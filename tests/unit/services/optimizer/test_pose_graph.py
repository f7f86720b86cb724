"""The graph of equation (1): which edges, in which order, with which weight."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from covinz.config import OdometryNoise, OptimizerConfig
from covinz.frames import inverse
from covinz.types import Keyframe
from services.optimizer.pose_graph import PoseGraph, build_graph, keyframe_ids
from tests.fleets import components_of, keyframe, make_fleet, only_component, perturb

CONFIG = OptimizerConfig()


def edges_by_seq(graph: PoseGraph) -> list[tuple[int, int]]:
    return [
        (int(graph.seq[i]), int(graph.seq[j]))
        for i, j, is_loop in zip(graph.edge_from, graph.edge_to, graph.is_loop, strict=True)
        if not is_loop
    ]


def chain(seqs: Sequence[int]) -> list[tuple[int, Keyframe]]:
    rng = np.random.default_rng(0)
    pose = {seq: perturb(rng, np.eye(4), np.ones(6)) for seq in sorted(seqs)}
    return [(index, keyframe("a", 0, seq, pose[seq])) for index, seq in enumerate(seqs)]


def test_edges_lead_from_the_four_nearest_predecessors_there_are() -> None:
    (component,) = components_of(chain([0, 1, 2, 7, 8, 20]), [])
    assert edges_by_seq(build_graph(component, CONFIG)) == [
        (0, 1),
        (0, 2), (1, 2),
        (0, 7), (1, 7), (2, 7),
        (0, 8), (1, 8), (2, 8), (7, 8),
        (1, 20), (2, 20), (7, 20), (8, 20),
    ]  # fmt: skip


def test_edges_do_not_depend_on_the_order_of_arrival() -> None:
    def measured(seqs: Sequence[int]) -> dict[tuple[int, int], tuple[bytes, bytes]]:
        (component,) = components_of(chain(seqs), [])
        graph = build_graph(component, CONFIG)
        names = keyframe_ids(graph, component)
        return {
            (names[i].seq, names[j].seq): (T.tobytes(), W.tobytes())
            for i, j, T, W in zip(
                graph.edge_from, graph.edge_to, graph.T_from_to, graph.information, strict=True
            )
        }

    assert measured([5, 0, 3, 1, 9, 4, 2]) == measured([0, 1, 2, 3, 4, 5, 9])


def test_nodes_are_in_log_order_across_segments() -> None:
    fleet = make_fleet(num_agents=3, length=4, loops_per_pair=2)
    component = only_component(fleet)
    graph = build_graph(component, CONFIG)
    assert keyframe_ids(graph, component) == tuple(kf.id for kf in fleet.keyframes)
    assert graph.log_index.tolist() == list(range(12))
    np.testing.assert_array_equal(graph.T_odom_body, [kf.T_odom_body for kf in fleet.keyframes])


def test_odometry_edges_measure_the_odometry_and_stay_within_a_segment() -> None:
    component = only_component(make_fleet(length=8, loops_per_pair=3))
    graph = build_graph(component, CONFIG)
    odometry = ~graph.is_loop
    i, j = graph.edge_from[odometry], graph.edge_to[odometry]
    assert (graph.segment[i] == graph.segment[j]).all()
    assert len(set(zip(i.tolist(), j.tolist(), strict=True))) == odometry.sum() == 2 * (4 * 8 - 10)
    np.testing.assert_allclose(
        graph.T_from_to[odometry], inverse(graph.T_odom_body[i]) @ graph.T_odom_body[j], atol=1e-12
    )


def test_loop_edges_lead_from_candidate_to_query_with_the_inverse_covariance() -> None:
    fleet = make_fleet(length=8, loops_per_pair=3)
    component = only_component(fleet)
    graph = build_graph(component, CONFIG)
    names = keyframe_ids(graph, component)
    loops = sorted(fleet.loops, key=lambda loop: loop.job_id)
    rows = np.flatnonzero(graph.is_loop)
    assert [names[i] for i in graph.edge_from[rows]] == [loop.cand for loop in loops]
    assert [names[j] for j in graph.edge_to[rows]] == [loop.query for loop in loops]
    for row, loop in zip(rows, loops, strict=True):
        np.testing.assert_array_equal(graph.T_from_to[row], loop.T_cand_query)
        np.testing.assert_allclose(graph.information[row] @ loop.covariance, np.eye(6), atol=1e-9)


def test_a_robot_that_stands_still_gets_the_floor() -> None:
    noise = OdometryNoise(min_rotation=0.01, min_translation=0.1)
    (component,) = components_of([(k, keyframe("a", 0, k)) for k in range(2)], [])
    graph = build_graph(component, CONFIG.model_copy(update={"odometry": noise}))
    np.testing.assert_allclose(graph.information[0], np.diag([1e4] * 3 + [1e2] * 3))


def test_each_agent_has_its_own_accuracy() -> None:
    fleet = make_fleet(num_agents=2, length=6)
    config = OptimizerConfig(odometry_of={"agent1": OdometryNoise(translation_per_sqrt_m=1.0)})
    graph = build_graph(only_component(fleet), config)
    reference = build_graph(only_component(fleet), CONFIG)
    changed = (graph.information != reference.information).any(axis=(1, 2))
    np.testing.assert_array_equal(changed, (graph.segment[graph.edge_to] == 1) & ~graph.is_loop)


@pytest.mark.parametrize("scale", [0.0, 1e12])
def test_information_is_positive_definite_for_any_covariance_of_an_agent(scale: float) -> None:
    keyframes = [
        (index, dataclasses.replace(kf, covariance=scale * np.ones((6, 6))))
        for index, kf in chain(range(8))
    ]
    (component,) = components_of(keyframes, [])
    information = build_graph(component, CONFIG).information
    assert (np.linalg.eigvalsh(information) > 0).all()
    np.testing.assert_array_equal(information, information.swapaxes(1, 2))
