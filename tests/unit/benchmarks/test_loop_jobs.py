"""Jobs of chosen pairs are those pairs, each once, with rigs as place recognition forms them."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from benchmarks.fleet import Fleet
from benchmarks.loop_jobs import far_pairs, jobs_of, near_pairs, random_pairs
from covinz.frames import so3_exp, transform
from covinz.keyframes import CameraNotFound, KeyframeNotFound
from covinz.types import KeyframeId

COUNT = 6
SESSIONS = {"a": "01ARZ3NDEKTSV4RRFFQ69G5FAV", "b": "01ARZ3NDEKTSV4RRFFQ69G5FAW"}


def name(agent: str, seq: int) -> KeyframeId:
    return KeyframeId(agent, SESSIONS[agent], seq)


def test_near_pairs_are_near_and_of_different_robots(fleet: Fleet) -> None:
    expected = {
        frozenset((name("a", i), name("b", j)))
        for i, j in product(range(COUNT), repeat=2)
        if abs(i - j) <= 1
    }
    assert near_pairs(fleet) == expected


def test_far_pairs_are_far(fleet: Fleet) -> None:
    # Three keyframes are 1.5 m; rounding decides about them.
    surely = {
        frozenset((name("a", i), name("b", j)))
        for i, j in product(range(COUNT), repeat=2)
        if abs(i - j) > 3
    }
    found = far_pairs(fleet)
    assert surely <= found
    assert not found & near_pairs(fleet)


def test_random_pairs_are_the_same_every_time() -> None:
    first, second = ([name(agent, i) for i in range(5)] for agent in ("a", "b"))
    drawn = random_pairs(first, second, 7)
    assert len(drawn) == 7
    assert drawn == random_pairs(first, second, 7)
    assert all({kf.agent for kf in pair} == {"a", "b"} for pair in drawn)


@pytest.mark.parametrize("profile", ["paper", "fast"])
def test_every_chosen_pair_becomes_one_job(fleet: Fleet, profile: str) -> None:
    pairs = near_pairs(fleet)
    jobs = jobs_of(fleet, pairs, profile)
    assert {frozenset((job.query, job.cand)) for job in jobs} == pairs
    assert len(jobs) == len(pairs)
    # The later one asks.
    assert {(job.query.agent, job.cand.agent) for job in jobs} == {("b", "a")}
    assert all(fleet.true_loop(job) is not None for job in jobs)


def test_rigs_are_those_of_the_profile(fleet: Fleet) -> None:
    (job,) = jobs_of(fleet, {frozenset((name("b", 3), name("a", 2)))}, "paper")
    assert [member.keyframe.seq for member in job.query_rig] == [3, 2]
    assert [member.keyframe.seq for member in job.cand_rig] == [2, 1, 3]
    T_cand_query = fleet.true_loop(job)
    assert T_cand_query is not None
    assert np.allclose(T_cand_query, transform(so3_exp([0, 0.3, 0]), [0.5, 0, 0]))


def test_what_is_not_there_is_not_found(fleet: Fleet) -> None:
    with pytest.raises(KeyframeNotFound):
        fleet.keyframe(name("a", COUNT))
    with pytest.raises(CameraNotFound):
        fleet.camera("0")
