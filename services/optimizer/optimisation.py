"""From a component to a map: start, optimise, and find the loop to blame when that fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import covinz_core
import numpy as np
from numpy.typing import NDArray

from covinz.config import OptimizerConfig
from covinz.frames import Array, inverse
from covinz.types import KeyframeId, LoopClosure, SegmentId
from services.optimizer.alignment import align_segments
from services.optimizer.components import Component, segment_groups
from services.optimizer.pose_graph import PoseGraph, build_graph, noise_of


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where a segment's odom frame is in a map.

    Attributes:
        keyframe: The newest optimised keyframe (highest seq); the placement is exact there.
        T_odom_body: (4, 4) odometry pose of that keyframe.
        T_map_odom: (4, 4).
    """

    keyframe: KeyframeId
    T_odom_body: Array
    T_map_odom: Array


@dataclass(frozen=True, slots=True, eq=False)
class MapEstimate:
    """An optimised map: a function of the component alone.

    Attributes:
        placements: By segment, from the oldest on.
        loops: The loops it reflects, by job id.
        log_index: (N,) int64 of its keyframes, ascending.
        T_map_body: (N, 4, 4).
        iterations: Of Levenberg-Marquardt.
        converged: False when the limit of iterations ended it.
    """

    placements: Mapping[SegmentId, Placement]
    loops: tuple[LoopClosure, ...]
    log_index: NDArray[np.int64]
    T_map_body: Array
    iterations: int
    converged: bool

    @property
    def map_id(self) -> str:
        """Session of the oldest segment."""
        return next(iter(self.placements)).session


@dataclass(frozen=True, slots=True)
class Fault:
    """A loop without which optimisation works and with which it fails."""

    job_id: str
    reason: str


Optimise = Callable[[Component, OptimizerConfig], MapEstimate]


def optimise(component: Component, config: OptimizerConfig) -> MapEstimate:
    """Optimise one map from scratch: equation (1) from the canonical start.

    Gauge: the oldest segment's keyframe with the lowest log index keeps its odometry pose, so the
    map frame is that segment's odom frame. Without loops odometry is the optimum.

    The Cauchy loss has a minimum at "this loop is wrong" too, in which a true loop that closes
    much drift can be caught. So the loops pull under a wider loss first.

    Raises:
        ValueError: If the graph is not a problem that can be optimised (from the core).

    Source: paper III-C, equation (1); decision 0003. Blake and Zisserman, "Visual
    reconstruction", 1987 (graduated non-convexity).
    """
    # What overflows here is caught by the core, which takes finite numbers only.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        graph = build_graph(component, config)
        if not component.loops:
            return _estimate(component, graph, graph.T_odom_body, 0, True)
        T_map_body = start_of(component, graph, config)
    result = minimised(graph, T_map_body, pose_graph_options(config))
    T_map_body = np.asarray(result.T_map_body)
    return _estimate(component, graph, T_map_body, result.num_iterations, result.converged)


def start_of(component: Component, graph: PoseGraph, config: OptimizerConfig) -> Array:
    """(N, 4, 4) poses with every segment placed rigidly by its loops. Source: decision 0003."""
    T_map_odom = align_segments(component, noise_of(config))
    by_segment = np.array([T_map_odom[segment.id] for segment in component.segments])
    T_map_body: Array = by_segment[graph.segment] @ graph.T_odom_body
    return T_map_body


def find_fault(
    component: Component, config: OptimizerConfig, reason: str, run: Optimise = optimise
) -> Fault:
    """The loop to blame when `run` raises ValueError(`reason`) for a component.

    Loops are added in the order of their job ids until it fails, by bisection. Without loops a
    component never fails, so there is one.
    """
    works, fails = 0, len(component.loops)
    while fails - works > 1:
        middle = (works + fails) // 2
        try:
            for part in _parts(component, component.loops[:middle]):
                run(part, config)
            works = middle
        except ValueError as error:
            fails, reason = middle, str(error)
    return Fault(component.loops[fails - 1].job_id, reason)


def pose_graph_options(config: OptimizerConfig) -> covinz_core.PoseGraphOptions:
    """The core's options for a map from scratch."""
    return covinz_core.PoseGraphOptions(
        cauchy_scale=config.cauchy_scale,
        cauchy_start_factor=config.cauchy_start_factor,
        max_num_iterations=config.max_iterations,
    )


def minimised(
    graph: PoseGraph, T_map_body: Array, options: covinz_core.PoseGraphOptions
) -> covinz_core.PoseGraphResult:
    """Minimise equation (1) from a start (N, 4, 4), with its node 0 as the gauge."""
    fixed = np.zeros(len(T_map_body), dtype=bool)
    fixed[0] = True
    return covinz_core.optimize_pose_graph(
        T_map_body,
        fixed,
        graph.edge_from,
        graph.edge_to,
        graph.T_from_to,
        graph.information,
        graph.is_loop,
        options,
    )


def _parts(component: Component, loops: Sequence[LoopClosure]) -> list[Component]:
    """What is left of a component with fewer loops."""
    by_id = {segment.id: segment for segment in component.segments}
    first = {segment.id: segment.first_log_index for segment in component.segments}
    return [
        Component(tuple(by_id[segment] for segment in segments), group)
        for segments, group in segment_groups(first, loops)
    ]


def _estimate(
    component: Component, graph: PoseGraph, T_map_body: Array, iterations: int, converged: bool
) -> MapEstimate:
    placements = {}
    for segment in component.segments:
        # Rows of a segment are in order of seq, nodes of the graph in order of log index.
        node = int(np.searchsorted(graph.log_index, segment.log_index[-1]))
        T_odom_body = segment.T_odom_body[-1]
        keyframe = KeyframeId(segment.id.agent, segment.id.session, int(segment.seq[-1]))
        T_map_odom = _correction(T_map_body[node], T_odom_body)
        placements[segment.id] = Placement(keyframe, T_odom_body, T_map_odom)
    return MapEstimate(
        placements, component.loops, graph.log_index, T_map_body, iterations, converged
    )


def _correction(T_map_body: Array, T_odom_body: Array) -> Array:
    """T_map_odom; exactly the identity where odometry was not moved."""
    if np.array_equal(T_map_body, T_odom_body):
        return np.eye(4)
    return T_map_body @ inverse(T_odom_body)
