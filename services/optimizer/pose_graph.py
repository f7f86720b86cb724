"""The pose graph of a map: nodes and edges of the paper's equation (1), in canonical order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz.config import OdometryNoise, OptimizerConfig
from covinz.frames import Array, inverse
from covinz.types import KeyframeId
from services.optimizer.components import Component, rows_of
from services.optimizer.odometry_noise import (
    bounded,
    composed,
    edge_shares,
    floor_covariance,
    step_covariances,
)
from services.optimizer.segments import Segment

NoiseOf = Callable[[str], OdometryNoise]


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """Nodes in log order; odometry edges by (to, from), then loop edges by job id.

    Attributes:
        log_index: (N,) int64, ascending.
        segment: (N,) int64 index into the segments of the component.
        seq: (N,) int64.
        stamp_ns: (N,) int64.
        T_odom_body: (N, 4, 4) each in the odom frame of its segment.
        edge_from: (M,) int64 index into the nodes; of a loop the candidate.
        edge_to: (M,) int64 index into the nodes; of a loop the query.
        T_from_to: (M, 4, 4) measured relative poses.
        information: (M, 6, 6) of the right perturbation, in the ``to`` body frame.
        is_loop: (M,) bool.
    """

    log_index: NDArray[np.int64]
    segment: NDArray[np.int64]
    seq: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    T_odom_body: Array
    edge_from: NDArray[np.int64]
    edge_to: NDArray[np.int64]
    T_from_to: Array
    information: Array
    is_loop: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Rows of edges; indices are rows of whatever they were built from."""

    edge_from: NDArray[np.int64]
    edge_to: NDArray[np.int64]
    T_from_to: Array
    information: Array


def noise_of(config: OptimizerConfig) -> NoiseOf:
    """Expected odometry accuracy by agent."""
    return lambda agent: config.odometry_of.get(agent, config.odometry)


def build_graph(component: Component, config: OptimizerConfig) -> PoseGraph:
    """The pose graph of a component: a function of its keyframes and loops as sets.

    Source: paper III-C, equation (1).
    """
    segments = component.segments
    log_index = np.concatenate([segment.log_index for segment in segments])
    order = np.argsort(log_index)
    node_of = np.empty_like(order)
    node_of[order] = np.arange(len(order))
    lengths = [len(segment) for segment in segments]
    odometry = _in_node_order(_all_odometry(segments, config), node_of)
    loops = _loop_edges(component, node_of)
    return PoseGraph(
        log_index=log_index[order],
        segment=np.repeat(np.arange(len(segments)), lengths)[order],
        seq=np.concatenate([segment.seq for segment in segments])[order],
        stamp_ns=np.concatenate([segment.stamp_ns for segment in segments])[order],
        T_odom_body=np.concatenate([segment.T_odom_body for segment in segments])[order],
        edge_from=np.concatenate([odometry.edge_from, loops.edge_from]),
        edge_to=np.concatenate([odometry.edge_to, loops.edge_to]),
        T_from_to=np.concatenate([odometry.T_from_to, loops.T_from_to]),
        information=np.concatenate([odometry.information, loops.information]),
        is_loop=np.repeat([False, True], [len(odometry.edge_to), len(loops.edge_to)]),
    )


def keyframe_ids(graph: PoseGraph, component: Component) -> tuple[KeyframeId, ...]:
    """Names of the nodes."""
    ids = [segment.id for segment in component.segments]
    return tuple(
        KeyframeId(ids[segment].agent, ids[segment].session, seq)
        for segment, seq in zip(graph.segment.tolist(), graph.seq.tolist(), strict=True)
    )


def odometry_edges(segment: Segment, noise: OdometryNoise, num_neighbours: int) -> Edges:
    """Edges from each keyframe's `num_neighbours` predecessors, the nearest there are, to it.

    Source: paper III-C, equation (1), first sum.
    """
    T = segment.T_odom_body
    T_prev_cur = inverse(T[:-1]) @ T[1:]
    steps = step_covariances(segment, noise)
    floor = floor_covariance(noise)
    parts = []
    for span, share in enumerate(edge_shares(len(segment), num_neighbours), start=1):
        rows = np.arange(len(segment) - span, dtype=np.int64)
        covariance = bounded(composed(T_prev_cur, steps, span)) + floor
        information = share[:, None, None] * _inverse_symmetric(covariance)
        parts.append(Edges(rows, rows + span, inverse(T[:-span]) @ T[span:], information))
    return _concatenated(parts)


def _all_odometry(segments: tuple[Segment, ...], config: OptimizerConfig) -> Edges:
    """Odometry edges of all segments; indices count through the segments."""
    parts, offset = [], 0
    expected = noise_of(config)
    for segment in segments:
        edges = odometry_edges(segment, expected(segment.id.agent), config.num_odometry_neighbours)
        parts.append(
            Edges(
                edges.edge_from + offset,
                edges.edge_to + offset,
                edges.T_from_to,
                edges.information,
            )
        )
        offset += len(segment)
    return _concatenated(parts)


def _loop_edges(component: Component, node_of: NDArray[np.int64]) -> Edges:
    """Loop edges, weighted by the inverse of their covariance. Source: paper III-C."""
    lengths = [len(segment) for segment in component.segments]
    start = np.concatenate([[0], np.cumsum(lengths)])

    def nodes(keyframes: list[KeyframeId]) -> NDArray[np.int64]:
        segment, row = rows_of(component, keyframes)
        return node_of[start[segment] + row]

    loops = component.loops
    return Edges(
        nodes([loop.cand for loop in loops]),
        nodes([loop.query for loop in loops]),
        np.array([loop.T_cand_query for loop in loops]).reshape(-1, 4, 4),
        _inverse_symmetric(np.array([loop.covariance for loop in loops]).reshape(-1, 6, 6)),
    )


def _in_node_order(edges: Edges, node_of: NDArray[np.int64]) -> Edges:
    """The same edges between nodes, sorted by (to, from)."""
    edge_from, edge_to = node_of[edges.edge_from], node_of[edges.edge_to]
    order = np.lexsort((edge_from, edge_to))
    return Edges(edge_from[order], edge_to[order], edges.T_from_to[order], edges.information[order])


def _concatenated(parts: list[Edges]) -> Edges:
    empty = Edges(
        np.empty(0, dtype=np.int64),
        np.empty(0, dtype=np.int64),
        np.empty((0, 4, 4)),
        np.empty((0, 6, 6)),
    )
    return Edges(
        np.concatenate([empty.edge_from, *(part.edge_from for part in parts)]),
        np.concatenate([empty.edge_to, *(part.edge_to for part in parts)]),
        np.concatenate([empty.T_from_to, *(part.T_from_to for part in parts)]),
        np.concatenate([empty.information, *(part.information for part in parts)]),
    )


def _inverse_symmetric(covariance: Array) -> Array:
    """Inverse of symmetric (..., 6, 6), symmetric to the last bit."""
    information = np.linalg.inv(covariance)
    result: Array = 0.5 * (information + information.swapaxes(-1, -2))
    return result
