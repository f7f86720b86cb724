"""Inputs and published maps: pending loops, what is stale, what an estimate replaces."""

from __future__ import annotations

import numpy as np
import pytest

from covinz.config import OptimizerConfig
from covinz.types import LoopClosure, MapSnapshot
from services.optimizer.maps import Maps
from services.optimizer.optimisation import optimise
from tests.fleets import Fleet, closure, keyframe, make_fleet, session

CONFIG = OptimizerConfig()


def maps_of(fleet: Fleet, loops: bool = True) -> Maps:
    maps = Maps(CONFIG)
    for index, kf in enumerate(fleet.keyframes):
        maps.add_keyframe(index, kf, revision=0)
    for loop in fleet.loops if loops else ():
        maps.add_loop(loop)
    return maps


def optimise_stale(maps: Maps, revision: int = 1) -> None:
    for group in maps.stale(with_keyframes=True):
        assert maps.apply(optimise(maps.component(group), CONFIG), revision)
    assert maps.stale(with_keyframes=True) == []


def snapshot_of(maps: Maps, number: int = 0) -> MapSnapshot:
    snapshot = maps.snapshot(session(number))
    assert snapshot is not None
    return snapshot


def test_a_segment_is_a_map_of_its_own_from_its_first_keyframe() -> None:
    maps = Maps(CONFIG)
    assert maps.add_keyframe(0, keyframe("a", 0, 5), revision=7)
    assert not maps.add_keyframe(1, keyframe("a", 0, 0), revision=8)
    assert maps.add_keyframe(2, keyframe("b", 1, 0), revision=9)
    summaries = maps.map_list().maps
    assert [(s.map_id, s.revision, s.num_keyframes, s.num_loops) for s in summaries] == [
        (session(0), 7, 2, 0),
        (session(1), 9, 1, 0),
    ]
    assert maps.stale(with_keyframes=True) == []
    assert maps.snapshot(session(2)) is None


def test_a_loop_waits_for_both_its_keyframes() -> None:
    maps = Maps(CONFIG)
    a, b = keyframe("a", 0, 3), keyframe("b", 1, 4)
    loop = closure(a.id, b.id)
    maps.add_loop(loop)
    maps.add_keyframe(0, keyframe("a", 0, 0), 0)
    maps.add_keyframe(1, keyframe("b", 1, 0), 0)
    maps.add_keyframe(2, a, 0)
    assert maps.pending == {loop.job_id}
    assert maps.stale(with_keyframes=True) == []
    maps.add_keyframe(3, b, 0)
    assert maps.pending == frozenset()
    assert maps.stale(with_keyframes=False) == [((a.id.segment, b.id.segment), (loop,))]


def test_a_merge_keeps_the_name_and_frame_of_the_older_map() -> None:
    fleet = make_fleet(num_agents=3, length=20)
    maps = maps_of(fleet)
    assert len(maps.map_list().maps) == 3
    optimise_stale(maps)
    (summary,) = maps.map_list().maps
    assert summary.map_id == session(0)
    assert [name.agent for name in summary.segments] == ["agent0", "agent1", "agent2"]
    assert (summary.num_keyframes, summary.num_loops) == (60, len(fleet.loops))
    np.testing.assert_array_equal(snapshot_of(maps).T_map_body[0], fleet.keyframes[0].T_odom_body)


def test_until_it_is_optimised_a_merge_is_not_published() -> None:
    maps = maps_of(make_fleet(length=20))
    snapshot = snapshot_of(maps)
    assert len(snapshot.keyframes) == 20
    assert not snapshot.is_loop.any()


def test_an_estimate_of_segments_that_have_merged_since_is_refused() -> None:
    fleet = make_fleet(num_agents=3, length=20)
    with_third = [loop for loop in fleet.loops if "agent2" in (loop.query.agent, loop.cand.agent)]
    maps = maps_of(fleet, loops=False)
    for loop in fleet.loops:
        if loop not in with_third:
            maps.add_loop(loop)
    (group,) = maps.stale(with_keyframes=False)
    estimate = optimise(maps.component(group), CONFIG)
    maps.add_loop(with_third[0] if with_third[0].cand.agent != "agent2" else with_third[1])
    assert not maps.apply(estimate, 1)
    assert len(maps.map_list().maps) == 3


def test_new_keyframes_are_placed_by_odometry_and_make_the_map_stale_only_with_loops() -> None:
    fleet = make_fleet(length=20)
    early, late = fleet.keyframes[:36], fleet.keyframes[36:]
    maps = maps_of(Fleet(early, [], {}, frozenset()))
    loops = [loop for loop in fleet.loops if max(loop.query.seq, loop.cand.seq) < 18]
    for loop in loops:
        maps.add_loop(loop)
    optimise_stale(maps)
    for index, kf in enumerate(late, start=36):
        maps.add_keyframe(index, kf, 1)
    assert maps.stale(with_keyframes=False) == []
    assert len(maps.stale(with_keyframes=True)) == 1
    snapshot = snapshot_of(maps)
    assert len(snapshot.keyframes) == 40
    for node, kf in enumerate(late, start=36):
        found = maps.placement(kf.id.segment)
        assert found is not None
        np.testing.assert_allclose(
            snapshot.T_map_body[node], found[1].T_map_odom @ kf.T_odom_body, atol=1e-12
        )


def test_a_loop_that_is_taken_out_splits_what_it_joined() -> None:
    maps = maps_of(make_fleet(length=20), loops=False)
    bridge = closure(keyframe("agent0", 0, 3).id, keyframe("agent1", 1, 3).id)
    maps.add_loop(bridge)
    optimise_stale(maps)
    assert len(maps.map_list().maps) == 1
    maps.remove_loop(bridge.job_id)
    assert len(maps.stale(with_keyframes=False)) == 2
    optimise_stale(maps, revision=2)
    assert [s.num_keyframes for s in maps.map_list().maps] == [20, 20]


@pytest.mark.parametrize("seed", range(3))
def test_maps_depend_on_neither_order_nor_timing_of_loops(seed: int) -> None:
    fleet = make_fleet(num_agents=3, length=20, wrong_share=0.2)
    reference = maps_of(fleet)
    optimise_stale(reference)
    rng = np.random.default_rng(seed)
    # Every loop comes somewhere between the keyframes, before or after its own.
    when = rng.integers(0, len(fleet.keyframes) + 1, size=len(fleet.loops))
    maps = Maps(CONFIG)
    for index in range(len(fleet.keyframes) + 1):
        here: list[LoopClosure] = [fleet.loops[n] for n in np.flatnonzero(when == index)]
        for loop in rng.permutation(np.array(here, dtype=object)):
            maps.add_loop(loop)
        if rng.random() < 0.05:
            optimise_stale(maps, revision=index)
        if index < len(fleet.keyframes):
            maps.add_keyframe(index, fleet.keyframes[index], 0)
    optimise_stale(maps)
    a, b = snapshot_of(reference), snapshot_of(maps)
    assert a.keyframes == b.keyframes
    for name in ("T_map_body", "edge_from", "edge_to", "T_from_to", "information", "is_loop"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
