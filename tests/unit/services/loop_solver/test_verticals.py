"""Gravity proposes poses; it never decides anything."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from covinz import frames
from covinz.config import FastLoopConfig, LoopSolverConfig
from covinz.types import Array, LoopClosure
from services.loop_solver.solver import LoopSolver
from services.loop_solver.verticals import verticals

DOWN_IN_CAND = np.array([0.6, 0.0, -0.8])


def send(room: Any, query: Array | None, cand: Array | None) -> None:
    for keyframe, gravity in ((room.job.query, query), (room.job.cand, cand)):
        stored = room.store.keyframes[keyframe]
        room.store.keyframes[keyframe] = dataclasses.replace(stored, gravity_body=gravity)


def down_in_query(room: Any) -> Array:
    direction: Array = room.T_cand_query[:3, :3].T @ DOWN_IN_CAND
    return direction


def loop(room: Any, use: bool = True) -> LoopClosure:
    config = LoopSolverConfig(profile="fast", fast=FastLoopConfig(use_verticals=use))
    outcome = LoopSolver(config, room.store).solve(room.job)
    assert isinstance(outcome, LoopClosure)
    return outcome


def test_both_must_know_it(room: Any) -> None:
    for query, cand in ((None, None), (DOWN_IN_CAND, None), (None, DOWN_IN_CAND)):
        send(room, query, cand)
        assert verticals(room.job, room.store) is None
    send(room, down_in_query(room), DOWN_IN_CAND)
    both = verticals(room.job, room.store)
    assert both is not None
    np.testing.assert_allclose(both.query, down_in_query(room), rtol=1e-12)
    np.testing.assert_allclose(both.cand, DOWN_IN_CAND, rtol=1e-12)


def test_a_direction_that_is_not_quite_of_length_one_is_made_so(room: Any) -> None:
    send(room, 1.0005 * down_in_query(room), 0.9995 * DOWN_IN_CAND)
    both = verticals(room.job, room.store)
    assert both is not None
    assert np.linalg.norm(both.query) == pytest.approx(1.0, abs=1e-12)
    loop(room)


def test_what_is_no_direction_is_not_known(room: Any) -> None:
    for bad in (np.zeros(3), np.full(3, np.nan)):
        send(room, down_in_query(room), bad)
        assert verticals(room.job, room.store) is None


def test_gravity_right_or_wrong_gives_the_same_loop(room: Any) -> None:
    plain = loop(room)
    rng = np.random.default_rng(2)
    wrong = rng.normal(size=3)
    for query in (down_in_query(room), -down_in_query(room), wrong / np.linalg.norm(wrong)):
        send(room, query, DOWN_IN_CAND)
        found = loop(room)
        error = frames.local_error(plain.T_cand_query, found.T_cand_query)
        # A twentieth of a standard deviation: another start of the same adjustment.
        assert error @ np.linalg.solve(plain.covariance, error) < 0.05**2 * 6
        assert abs(found.num_inliers - plain.num_inliers) <= 0.02 * plain.num_inliers


def test_it_can_be_switched_off(room: Any) -> None:
    plain = loop(room)
    send(room, down_in_query(room), DOWN_IN_CAND)
    np.testing.assert_array_equal(loop(room, use=False).T_cand_query, plain.T_cand_query)
