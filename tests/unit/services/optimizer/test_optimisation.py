"""Maps from generated fleets against the truth; the same map whatever the order."""

from __future__ import annotations

import dataclasses
import random

import numpy as np
import pytest

from covinz.config import OptimizerConfig
from covinz.frames import Array
from covinz.types import LoopClosure
from services.optimizer.components import Component
from services.optimizer.optimisation import MapEstimate, find_fault, optimise
from services.optimizer.worker import run_job
from tests.fleets import (
    Fleet,
    aligned_rmse,
    closure,
    components_of,
    keyframe,
    make_fleet,
    only_component,
    perturb,
    session,
)

CONFIG = OptimizerConfig()


def truth(fleet: Fleet) -> Array:
    return np.array([fleet.T_world_body[kf.id] for kf in fleet.keyframes])


def error_m(fleet: Fleet) -> float:
    estimate = optimise(only_component(fleet), CONFIG)
    assert len(estimate.T_map_body) == len(fleet.keyframes)
    return aligned_rmse(estimate.T_map_body, truth(fleet))


def odometry_error_m(fleet: Fleet) -> float:
    """Each agent's odometry aligned on its own: what it has without a server."""
    T_world = truth(fleet)
    agents = np.array([kf.id.agent for kf in fleet.keyframes])
    T_odom = np.array([kf.T_odom_body for kf in fleet.keyframes])
    return max(aligned_rmse(T_odom[agents == a], T_world[agents == a]) for a in set(agents))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("num_agents", [2, 3])
def test_segments_merge_into_one_map_better_than_their_odometry(seed: int, num_agents: int) -> None:
    fleet = make_fleet(seed, num_agents=num_agents)
    assert error_m(fleet) < 0.12 < odometry_error_m(fleet)


@pytest.mark.parametrize("seed", range(3))
def test_a_fifth_of_wrong_loops_does_little_harm(seed: int) -> None:
    clean = make_fleet(seed, num_agents=3)
    spoiled = make_fleet(seed, num_agents=3, wrong_share=0.2)
    assert len(spoiled.wrong) == 18
    assert error_m(spoiled) < 1.5 * error_m(clean)


def test_the_gauge_is_the_odometry_of_the_oldest_keyframe() -> None:
    fleet = make_fleet(seed=4)
    frames = {
        agent: perturb(np.random.default_rng(n), np.eye(4), np.ones(6))
        for n, agent in enumerate(("agent0", "agent1"))
    }
    keyframes = [
        dataclasses.replace(kf, T_odom_body=frames[kf.id.agent] @ kf.T_odom_body)
        for kf in fleet.keyframes
    ]
    moved = dataclasses.replace(fleet, keyframes=keyframes)
    a, b = (optimise(only_component(f), CONFIG) for f in (fleet, moved))
    np.testing.assert_array_equal(a.T_map_body[0], fleet.keyframes[0].T_odom_body)
    np.testing.assert_array_equal(b.T_map_body[0], moved.keyframes[0].T_odom_body)
    # Another odom frame of each agent: the same map, seen from the oldest one's.
    T_b_a = b.T_map_body[0] @ np.linalg.inv(a.T_map_body[0])
    np.testing.assert_allclose(T_b_a @ a.T_map_body, b.T_map_body, atol=1e-3)


def test_without_loops_odometry_is_the_map() -> None:
    fleet = make_fleet(num_agents=1, loops_per_pair=0)
    estimate = optimise(only_component(fleet), CONFIG)
    np.testing.assert_array_equal(estimate.T_map_body, [kf.T_odom_body for kf in fleet.keyframes])
    (placement,) = estimate.placements.values()
    np.testing.assert_array_equal(placement.T_map_odom, np.eye(4))
    assert placement.keyframe.seq == 59


def test_the_placement_is_exact_at_the_newest_keyframe() -> None:
    fleet = make_fleet(num_agents=2)
    estimate = optimise(only_component(fleet), CONFIG)
    for placement in estimate.placements.values():
        node = [kf.id for kf in fleet.keyframes].index(placement.keyframe)
        assert placement.keyframe.seq == 59
        np.testing.assert_allclose(
            placement.T_map_odom @ fleet.keyframes[node].T_odom_body,
            estimate.T_map_body[node],
            atol=1e-12,
        )


def test_shuffled_loops_and_arrival_give_the_same_bits() -> None:
    fleet = make_fleet(num_agents=3, length=30, wrong_share=0.2)
    log = list(enumerate(fleet.keyframes))
    (component,) = components_of(log, fleet.loops)
    reference = optimise(component, CONFIG)
    for seed in range(4):
        shuffled = random.Random(seed).sample(fleet.loops, len(fleet.loops))
        (component,) = components_of(log, shuffled)
        again = optimise(component, CONFIG)
        assert again.map_id == reference.map_id
        assert again.T_map_body.tobytes() == reference.T_map_body.tobytes()


def overflowing(fleet: Fleet) -> LoopClosure:
    """A loop whose squared error is no finite number, so that the core refuses the graph."""
    T = np.eye(4)
    T[0, 3] = 1e200
    query, cand = fleet.loops[-1].query, fleet.loops[-1].cand
    return closure(query, cand, T, "7" * 32)


def test_the_loop_that_makes_optimisation_fail_is_found() -> None:
    fleet = make_fleet(num_agents=2, length=20)
    bad = overflowing(fleet)
    (component,) = components_of(enumerate(fleet.keyframes), [*fleet.loops, bad])
    with pytest.raises(ValueError) as failure:
        optimise(component, CONFIG)
    fault = find_fault(component, CONFIG, str(failure.value))
    assert fault.job_id == bad.job_id
    assert fault.reason


def test_a_bad_loop_of_one_map_does_not_keep_others_from_theirs() -> None:
    fleet = make_fleet(num_agents=3, length=20)
    inside = [loop for loop in fleet.loops if loop.query.agent == loop.cand.agent]
    bad = closure(
        keyframe("agent0", 0, 1).id,
        keyframe("agent0", 0, 9).id,
        overflowing(fleet).T_cand_query,
    )
    components = components_of(enumerate(fleet.keyframes), [*inside, bad])
    done = run_job(tuple(components), 7, CONFIG)
    assert done.epoch == 7
    assert [fault.job_id for fault in done.faults] == [bad.job_id]
    assert [estimate.map_id for estimate in done.estimates] == [session(1), session(2)]


def test_any_other_error_is_not_blamed_on_a_loop() -> None:
    def defect(component: Component, config: OptimizerConfig) -> MapEstimate:
        raise TypeError("a defect")

    component = only_component(make_fleet(length=10))
    with pytest.raises(TypeError):
        run_job((Component(component.segments, component.loops),), 0, CONFIG, defect)


@pytest.mark.parametrize(("leap_m", "variance"), [(3e8, None), (1e6, 1e4)])
def test_odometry_that_blew_up_costs_nobody_a_loop(leap_m: float, variance: float | None) -> None:
    # Leaps and turns are levers that make covariances of which nothing survives rounding.
    rng = np.random.default_rng(2)
    covariance = None if variance is None else np.diag([variance, 0.0, 0.0, 0.0, 0.0, 0.0])
    wild = []
    for seq in range(8):
        T = perturb(rng, np.eye(4), np.repeat([3.0, leap_m], 3))
        wild.append(dataclasses.replace(keyframe("c", 9, seq, T), covariance=covariance))
    # On its own the wild segment is a map like any other.
    (alone,) = components_of(enumerate(wild), [])
    assert optimise(alone, CONFIG).converged
    fleet = make_fleet(length=20)
    bridges = [closure(wild[seq].id, fleet.keyframes[seq].id) for seq in (0, 7)]
    (component,) = components_of(enumerate([*fleet.keyframes, *wild]), [*fleet.loops, *bridges])
    done = run_job((component,), 0, CONFIG)
    assert {fault.job_id for fault in done.faults} <= {loop.job_id for loop in bridges}
    for estimate in done.estimates:
        assert np.isfinite(estimate.T_map_body).all()
