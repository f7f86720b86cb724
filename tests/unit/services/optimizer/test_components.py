"""Maps are the connected components of segments over loops."""

from __future__ import annotations

import itertools

import pytest

from covinz.types import LoopClosure
from services.optimizer.components import rows_of, segment_groups
from tests.fleets import closure, components_of, keyframe


def test_groups_do_not_depend_on_the_order_of_loops() -> None:
    kf = [keyframe(f"agent{n}", n, 0).id for n in range(5)]
    first = {kf[n].segment: 10 - n for n in range(5)}
    loops = [closure(kf[0], kf[1]), closure(kf[3], kf[1]), closure(kf[4], kf[4])]
    expected = [
        ((kf[4].segment,), (loops[2],)),
        ((kf[3].segment, kf[1].segment, kf[0].segment), tuple(sorted(loops[:2], key=job_id))),
        ((kf[2].segment,), ()),
    ]
    for order in itertools.permutations(loops):
        assert segment_groups(first, order) == expected


def test_rows_are_found_in_each_segment() -> None:
    keyframes = [keyframe("a", 0, 3), keyframe("b", 1, 5), keyframe("a", 0, 1)]
    loop = closure(keyframes[0].id, keyframes[1].id)
    (component,) = components_of(enumerate(keyframes), [loop])
    segments, rows = rows_of(component, [kf.id for kf in keyframes])
    assert segments.tolist() == [0, 1, 0]
    assert rows.tolist() == [1, 0, 0]
    assert [len(found) for found in rows_of(component, [])] == [0, 0]
    for unknown in (keyframe("a", 0, 2).id, keyframe("c", 2, 3).id):
        with pytest.raises(KeyError):
            rows_of(component, [unknown])


def test_loops_within_a_segment_join_nothing() -> None:
    a, b = keyframe("a", 0, 0).id, keyframe("a", 0, 9).id
    loop = closure(b, a)
    assert segment_groups({a.segment: 0}, [loop]) == [((a.segment,), (loop,))]


def job_id(loop: LoopClosure) -> str:
    return loop.job_id
