"""Pairs whose rigs do not tell the scale wait for a little more of their sessions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest

from covinz.config import LoopSolverConfig
from covinz.frames import transform
from covinz.types import Keyframe, KeyframeId, LogEntry, LoopJob
from services.place_recognition.recognizer import PATIENCE, Recognizer

Kid = Callable[[str, int], KeyframeId]
LogOf = Callable[[Iterable[Keyframe]], list[LogEntry]]
Describe = Callable[[Iterable[LoopJob]], list[object]]


@dataclasses.dataclass(frozen=True)
class Street:
    """Robots that stand, unless told where they are."""

    world: Any

    def keyframe(
        self, name: str, seq: int, place: int, x_m: float = 0.0, **kwargs: Any
    ) -> Keyframe:
        kf: Keyframe = self.world.keyframe(name, seq, place, **kwargs)
        return dataclasses.replace(kf, T_odom_body=transform(np.eye(3), [x_m, 0.0, 0.0]))

    def standing(self, name: str, places: Iterable[int]) -> list[Keyframe]:
        return [self.keyframe(name, seq, place) for seq, place in enumerate(places)]

    def past(self) -> list[Keyframe]:
        """Robot ``a`` saw place 2 and has gone on; ``d`` gives the votes their weight."""
        return [
            *self.standing("d", [9, 10, 11]),
            *self.standing("a", [0, 1, 2, 3, 4]),
            self.keyframe("b", 0, 8),
        ]


@pytest.fixture
def street(world: Any) -> Street:
    return Street(world)


def jobs_by_entry(recognizer: Recognizer, entries: Iterable[LogEntry]) -> list[list[LoopJob]]:
    return [recognizer.process(entry) for entry in entries]


def counts(world: Any, log_of: LogOf, keyframes: list[Keyframe], **options: Any) -> list[int]:
    found = jobs_by_entry(world.recognizer(**options), log_of(keyframes))
    return [len(jobs) for jobs in found]


def test_without_scale_a_pair_waits_for_two_keyframes(
    world: Any, log_of: LogOf, kid: Kid, street: Street
) -> None:
    query = street.keyframe("b", 1, 2)
    after = [street.keyframe("b", 2, 6), street.keyframe("b", 3, 7), street.keyframe("b", 4, 5)]
    recognizer = world.recognizer()
    past = street.past()
    assert not any(jobs_by_entry(recognizer, log_of([*past, query, after[0]])))
    assert recognizer.waiting == 1
    (job,) = recognizer.process(LogEntry(len(past) + 2, after[1]))
    assert (job.query, job.cand) == (kid("b", 1), kid("a", 2))
    # Standing still is answered by the solver, with the nearest keyframes there are.
    assert [m.keyframe.seq for m in (*job.query_rig, *job.cand_rig)] == [1, 0, 2, 1, 3]
    assert recognizer.waiting == 0
    assert recognizer.process(LogEntry(len(past) + 3, after[2])) == []


def test_keyframes_that_take_no_part_end_the_wait_too(
    world: Any, log_of: LogOf, street: Street
) -> None:
    dark = [street.keyframe("b", seq, 6, num_features=3) for seq in (2, 3)]
    keyframes = [*street.past(), street.keyframe("b", 1, 2), *dark]
    assert counts(world, log_of, keyframes)[-3:] == [0, 0, 1]


def test_a_keyframe_that_tells_the_scale_ends_the_wait(
    world: Any, log_of: LogOf, street: Street
) -> None:
    moved = street.keyframe("b", 2, 6, x_m=0.3)
    keyframes = [*street.past(), street.keyframe("b", 1, 2), moved]
    *_, (job,) = jobs_by_entry(world.recognizer(), log_of(keyframes))
    assert [m.keyframe.seq for m in job.query_rig] == [1, 2]


def test_one_rig_that_tells_the_scale_is_enough(world: Any, log_of: LogOf, street: Street) -> None:
    query = street.keyframe("b", 1, 2, x_m=0.3)
    assert counts(world, log_of, [*street.past(), query])[-1] == 1


def test_a_new_session_ends_the_wait_for_the_old_one(
    world: Any, log_of: LogOf, kid: Kid, street: Street
) -> None:
    # The candidate is a session's last keyframe, and the query's session goes on.
    keyframes = [
        *street.standing("d", [9, 10, 11]),
        *street.standing("a", [0, 1, 2]),
        *street.standing("b", [8, 2, 6, 7, 5]),
    ]
    recognizer = world.recognizer()
    assert not any(jobs_by_entry(recognizer, log_of(keyframes)))
    (job,) = recognizer.process(LogEntry(len(keyframes), street.keyframe("a2", 0, 4)))
    assert (job.query, job.cand) == (kid("b", 1), kid("a", 2))


def test_the_paper_s_rule_does_not_wait(world: Any, log_of: LogOf, street: Street) -> None:
    keyframes = [*street.past(), street.keyframe("b", 1, 2)]
    assert counts(world, log_of, keyframes, solver=LoopSolverConfig(profile="paper"))[-1] == 1


def test_waiting_leaves_jobs_a_function_of_the_log(
    world: Any, log_of: LogOf, describe: Describe, street: Street
) -> None:
    keyframes = [*street.past(), *street.standing("c", [8, 2, 1, 0, 3, 4, 2])]
    entries = log_of(keyframes)
    found = jobs_by_entry(world.recognizer(), entries)
    assert sum(map(len, found)) > 2
    for cut in range(len(entries)):
        again = jobs_by_entry(world.recognizer(), entries[:cut])
        assert [describe(jobs) for jobs in again] == [describe(jobs) for jobs in found[:cut]]
    # Never more than so many keyframes late.
    late = [
        entry.item.id.seq - job.query.seq
        for entry, jobs in zip(entries, found, strict=True)
        for job in jobs
        if isinstance(entry.item, Keyframe) and entry.item.id.segment == job.query.segment
    ]
    assert max(late) <= PATIENCE
