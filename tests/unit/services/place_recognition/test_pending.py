from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz.types import KeyframeId, LoopJob, RigMember
from services.place_recognition.loop_graph import LoopGraph
from services.place_recognition.pending import CHOICE, Pending

SESSION = "01ARZ3NDEKTSV4RRFFQ69G5FAV"


def kf(agent: str, seq: int) -> KeyframeId:
    return KeyframeId(agent, SESSION, seq)


def job(query: KeyframeId, cand: KeyframeId) -> LoopJob:
    def member(name: KeyframeId) -> RigMember:
        return RigMember(name, np.eye(4), "0123456789abcdef")

    return LoopJob("0" * 32, (member(query),), (member(cand),), 1.0)


def test_between_maps_then_the_longest_way_then_the_newest() -> None:
    graph = LoopGraph()
    graph.join(kf("a", 10), kf("b", 10))
    pending = Pending(graph)
    pairs = [
        (kf("a", 12), kf("b", 12)),  # 4 keyframes over the loop
        (kf("a", 90), kf("a", 0)),
        (kf("a", 40), kf("b", 60)),  # 80
        (kf("a", 91), kf("a", 1)),  # as long as the one before, and newer
        (kf("c", 0), kf("a", 0)),
        (kf("d", 0), kf("c", 0)),
    ]
    for number, pair in enumerate(pairs):
        pending.add(number, job(*pair))
    assert [pending.pop() for _ in pairs] == [5, 4, 3, 1, 2, 0]
    with pytest.raises(IndexError):
        pending.pop()


def test_sessions_joined_over_a_third_are_one_map_with_an_unknown_way() -> None:
    graph = LoopGraph()
    graph.join(kf("a", 0), kf("b", 0))
    graph.join(kf("c", 0), kf("b", 9))
    assert not graph.is_between_maps(kf("a", 5), kf("c", 5))
    assert graph.is_between_maps(kf("a", 5), kf("d", 5))
    assert graph.way(kf("a", 5), kf("c", 5)) == np.inf
    assert graph.way(kf("b", 3), kf("a", 5)) == graph.way(kf("a", 5), kf("b", 3)) == 8
    assert graph.way(kf("a", 5), kf("a", 1)) == 4


@given(st.integers(0, 2**32))
def test_the_order_is_that_of_a_sort_whatever_is_joined_meanwhile(seed: int) -> None:
    draw = random.Random(seed)
    graph = LoopGraph()
    pending = Pending(graph)
    waiting: dict[int, LoopJob] = {}

    def some() -> KeyframeId:
        return kf(draw.choice("abcd"), draw.randrange(60))

    def usefulness(number: int) -> tuple[bool, float, int]:
        one = waiting[number]
        if graph.is_between_maps(one.query, one.cand):
            return (False, 0.0, -number)
        return (True, -graph.way(one.query, one.cand), -number)

    for number in range(60):
        match draw.randrange(5):
            case 0:
                graph.join(some(), some())
            case 1 if waiting:
                number = pending.pop()
                assert number == min(waiting, key=usefulness)
                del waiting[number]
            case 2 if waiting:
                number = draw.choice(list(waiting))
                pending.discard(number)
                del waiting[number]
            case 3 if len(waiting) > 9:
                shed = pending.overflow(8)
                assert shed == sorted(waiting, key=usefulness)[8:]
                for number in shed:
                    del waiting[number]
            case _:
                waiting[number] = job(some(), some())
                pending.add(number, waiting[number])
        assert len(pending) == len(waiting)


def waiting(*pairs: tuple[KeyframeId, KeyframeId], graph: LoopGraph) -> Pending:
    pending = Pending(graph)
    for number, pair in enumerate(pairs):
        pending.add(number, job(*pair))
    return pending


def one_map() -> LoopGraph:
    graph = LoopGraph()
    graph.join(kf("a", 0), kf("b", 0))
    return graph


def test_among_the_most_useful_ones_who_asks_gets_what_suits() -> None:
    # All bridge ways of different lengths; the first is the longest.
    pairs = [(kf("a", 500 - 10 * way), kf("a", 0)) for way in range(CHOICE + 1)]
    pending = waiting(*pairs, graph=one_map())

    def suits(one: LoopJob) -> int:
        return int(one.query in (kf("a", 470), kf("a", 460)))

    assert [pending.pop(suits) for _ in range(4)] == [3, 4, 0, 1]
    assert len(pending) == CHOICE - 3


def test_beyond_the_most_useful_ones_nobody_chooses() -> None:
    pairs = [(kf("a", 500 - 10 * way), kf("a", 0)) for way in range(CHOICE + 1)]
    pending = waiting(*pairs, graph=one_map())
    least = pairs[-1][0]
    assert pending.pop(lambda one: int(one.query == least)) == 0
    assert pending.pop(lambda one: int(one.query == least)) == CHOICE


def test_no_job_within_a_map_goes_before_one_between_maps() -> None:
    pairs = [(kf("c", 0), kf("a", 0)), (kf("a", 90), kf("a", 0))]
    pending = waiting(*pairs, graph=one_map())
    assert pending.pop(lambda one: int(one.query.agent == "a")) == 0


def test_the_most_useful_job_is_passed_over_only_so_often() -> None:
    pending = waiting((kf("a", 999), kf("a", 0)), graph=one_map())
    order = []
    for number in range(1, 3 * CHOICE):
        pending.add(number, job(kf("a", 500 - number), kf("a", 0)))
        order.append(pending.pop(lambda one: int(one.query.seq != 999)))
    assert order.index(0) == CHOICE


@given(st.integers(0, 2**32))
def test_whoever_chooses_every_job_is_taken_once(seed: int) -> None:
    draw = random.Random(seed)
    graph = LoopGraph()
    pairs = [
        (kf(draw.choice("abcd"), draw.randrange(60)), kf(draw.choice("abcd"), draw.randrange(60)))
        for _ in range(40)
    ]
    pending = waiting(*pairs, graph=graph)
    taken = []
    while len(pending):
        taken.append(pending.pop(lambda _: draw.randrange(3)))
        graph.join(*pairs[draw.randrange(40)])
    assert sorted(taken) == list(range(40))
