"""The start of the optimisation: segments placed by their loops, wrong ones outvoted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from covinz.config import OdometryNoise, OptimizerConfig
from covinz.frames import Array, adjoint, inverse, rotation_angle
from covinz.types import LoopClosure
from services.optimizer.alignment import MAX_HYPOTHESES, align_segments
from services.optimizer.components import Component
from services.optimizer.pose_graph import noise_of
from tests.fleets import Fleet, closure, components_of, make_fleet, only_component

NOISE = noise_of(OptimizerConfig())
STILL = OdometryNoise(
    rotation_per_sqrt_m=0.0,
    rotation_per_sqrt_rad=0.0,
    translation_per_sqrt_m=0.0,
    translation_per_sqrt_rad=0.0,
)


def errors(fleet: Fleet, component: Component) -> list[tuple[float, float]]:
    """Metres and radians by which each segment's odom frame is off, from its first keyframe."""
    T_map_odom = align_segments(component, NOISE)
    names = [kf.id for kf in fleet.keyframes]
    first = {name.segment: fleet.T_world_body[name] for name in reversed(names)}
    T_world_map = first[component.segments[0].id]
    off = [inverse(T_world_map @ T_map_odom[name]) @ first[name] for name in T_map_odom]
    return [(float(np.linalg.norm(T[:3, 3])), float(rotation_angle(T))) for T in off]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("wrong_share", [0.0, 0.4])
def test_segments_land_where_their_loops_put_them(seed: int, wrong_share: float) -> None:
    fleet = make_fleet(seed, num_agents=3, wrong_share=wrong_share, noise=STILL)
    for metres, radians in errors(fleet, only_component(fleet)):
        assert metres < 0.4
        assert radians < 0.06


def test_the_oldest_segment_is_the_frame() -> None:
    component = only_component(make_fleet())
    np.testing.assert_array_equal(
        align_segments(component, NOISE)[component.segments[0].id], np.eye(4)
    )


def with_covariance(loop: LoopClosure, covariance: Array) -> LoopClosure:
    return dataclasses.replace(loop, covariance=0.5 * (covariance + covariance.T))


@pytest.mark.parametrize("seed", range(5))
def test_swapping_query_and_candidate_changes_nothing(seed: int) -> None:
    """A covariance is of the query body: said the other way round, it is that of the candidate."""
    component = only_component(make_fleet(seed, num_agents=3, wrong_share=0.4))
    rng = np.random.default_rng(seed)
    loops = [
        with_covariance(loop, np.diag(rng.uniform(0.01, 0.3, 6) ** 2)) for loop in component.loops
    ]
    swapped = [
        with_covariance(
            closure(loop.cand, loop.query, inverse(loop.T_cand_query), loop.job_id),
            adjoint(loop.T_cand_query) @ loop.covariance @ adjoint(loop.T_cand_query).T,
        )
        for loop in loops
    ]
    a = align_segments(Component(component.segments, tuple(loops)), NOISE)
    b = align_segments(Component(component.segments, tuple(swapped)), NOISE)
    assert list(a) == list(b)
    for name, T in a.items():
        np.testing.assert_allclose(T, b[name], atol=1e-9)


def test_segments_are_placed_along_the_strongest_support() -> None:
    # 0 - 2 has four loops, 2 - 1 has four, 0 - 1 has a single, wrong one.
    fleet = make_fleet(num_agents=3, loops_per_pair=4, noise=STILL)
    agents = [{loop.query.agent, loop.cand.agent} for loop in fleet.loops]
    direct = [n for n, pair in enumerate(agents) if pair == {"agent0", "agent1"}]
    wrong = closure(fleet.loops[direct[0]].query, fleet.loops[direct[0]].cand)
    loops = [wrong] + [loop for n, loop in enumerate(fleet.loops) if n not in direct]
    (component,) = components_of(enumerate(fleet.keyframes), loops)
    assert list(align_segments(component, NOISE)) == [
        component.segments[0].id,
        component.segments[2].id,
        component.segments[1].id,
    ]
    assert max(metres for metres, _ in errors(fleet, component)) < 0.4


def test_more_loops_than_hypotheses() -> None:
    fleet = make_fleet(loops_per_pair=3 * MAX_HYPOTHESES, wrong_share=0.3, noise=STILL)
    for metres, radians in errors(fleet, only_component(fleet)):
        assert metres < 0.2
        assert radians < 0.05


def test_segments_without_a_loop_between_them_are_refused() -> None:
    component = only_component(make_fleet())
    within = tuple(loop for loop in component.loops if loop.query.segment == loop.cand.segment)
    with pytest.raises(ValueError, match="no loops to agent1/"):
        align_segments(Component(component.segments, within), NOISE)
