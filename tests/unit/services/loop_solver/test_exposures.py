"""What the core is told of stamps and shutters, and what becomes of a loop by it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from covinz import frames
from covinz.config import FastLoopConfig, LoopSolverConfig
from covinz.types import Array, LoopClosure, Outcome, Rejection
from services.loop_solver.exposures import rig_exposures
from services.loop_solver.solver import LoopSolver

SIGMA_S = 1 / 30 / np.sqrt(12)


def turned(room: Any, rad_s: float, readout_s: float | None = None) -> Any:
    """The room with bodies that turn about their z when they take images."""
    twists = np.tile([0.0, 0.0, rad_s, 0.0, 0.0, 0.0], (2, 1))
    store = dataclasses.replace(
        room.store,
        cameras={
            name: dataclasses.replace(camera, readout_s=readout_s)
            for name, camera in room.store.cameras.items()
        },
    )
    rigs = {
        side: tuple(dataclasses.replace(m, twists=twists) for m in getattr(room.job, side))
        for side in ("query_rig", "cand_rig")
    }
    return dataclasses.replace(room, store=store, job=dataclasses.replace(room.job, **rigs))


def solve(room: Any, config: LoopSolverConfig | None = None) -> Outcome:
    outcome = LoopSolver(config or LoopSolverConfig(), room.store).solve(room.job)
    return dataclasses.replace(outcome, solver_ms=0.0)


def covariance(outcome: Outcome) -> Array:
    assert isinstance(outcome, LoopClosure)
    return outcome.covariance


def test_turning_bodies_add_their_stamps_errors_at_both_ends(room: Any) -> None:
    at_rest, turning = covariance(solve(room)), covariance(solve(turned(room, 0.2)))
    # About the axes of both bodies; the shutter adds to it.
    T_query_cand = frames.inverse(room.T_cand_query)
    axes = np.stack([[0.0, 0.0, 1.0], T_query_cand[:3, 2]])
    least = (0.2 * SIGMA_S) ** 2 * axes.T @ axes
    added = (turning - at_rest)[:3, :3]
    assert np.linalg.eigvalsh(added - 0.5 * least)[0] > -1e-7
    assert np.trace(added) > 0.8 * np.trace(least)


def test_a_global_shutter_is_as_at_rest_to_the_last_bit(room: Any) -> None:
    at_rest, turning = solve(room), solve(turned(room, 3.0, readout_s=0.0))
    assert isinstance(at_rest, LoopClosure) and isinstance(turning, LoopClosure)
    np.testing.assert_array_equal(at_rest.T_cand_query, turning.T_cand_query)
    np.testing.assert_array_equal(at_rest.covariance, turning.covariance)


def test_the_configuration_speaks_for_cameras_that_do_not(room: Any) -> None:
    config = LoopSolverConfig(fast=FastLoopConfig(readout_s=0.0))
    np.testing.assert_array_equal(
        covariance(solve(turned(room, 3.0), config)), covariance(solve(room))
    )


def test_a_turn_that_outdoes_the_parallax_leaves_no_scale(room: Any) -> None:
    outcome = solve(turned(room, 20.0))
    assert isinstance(outcome, Rejection) and outcome.stage == "scale"
    assert 0 < outcome.count < outcome.threshold


def test_members_without_twists_are_at_rest(room: Any) -> None:
    exposures = rig_exposures(room.job.query_rig, room.store, 1 / 30)
    assert len(exposures) == len(room.job.query_rig)


def test_twists_need_two_rows(room: Any) -> None:
    with pytest.raises(ValueError, match="shape"):
        dataclasses.replace(room.job.query_rig[0], twists=np.zeros(6))
