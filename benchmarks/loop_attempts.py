"""The loop attempts that loop_accuracy.py makes, scenario by scenario, with their ground truth."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

from benchmarks.fleet import Fleet, gather
from benchmarks.loop_figures import Limits
from benchmarks.loop_jobs import Pair, far_pairs, jobs_of, near_pairs, random_pairs
from covinz import frames
from covinz.config import KeyframeSelectionConfig
from covinz.loop_edges import WRONG_M, WRONG_RAD
from covinz.scenario import Scenario, TumAgent, load_scenario
from covinz.types import Array, KeyframeId, LoopJob

_REPOSITORY = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("COVINZ_DATA", _REPOSITORY.parent / "shared" / "data"))
_FRAMES = ((0, 399), (300, 699), (600, 999))
_ELSEWHERE = 300
# Attempts of a played scenario that the paper's profile makes at most.
_OF_PAPER = 300
# Of redkitchen's ground truth of a pair, in all; a third of the variance an axis.
_TRUTH_RAD = np.deg2rad(1.2)
_TRUTH_M = 0.04
_TRUTH_COVARIANCE = np.diag(np.repeat([_TRUTH_RAD**2 / 3, _TRUTH_M**2 / 3], 3))

Jobs = Mapping[tuple[KeyframeId, KeyframeId], LoopJob]


@dataclass(frozen=True, slots=True, eq=False)
class Attempts:
    """The attempts of a scenario.

    Attributes:
        fleet: Whose.
        jobs: Of each profile, by query and candidate.
        limits: Beyond them a loop is wrong.
        of_truth: (6, 6) covariance of the ground truth of a pair; None where it is exact.
    """

    fleet: Fleet
    jobs: Mapping[str, Jobs]
    limits: Limits
    of_truth: Array | None = None


@cache
def redkitchen(data: Path) -> Fleet:
    """Three robots that are overlapping parts of the recording."""
    scenario = read_scenario("redkitchen", data)
    base = next(agent for agent in scenario.agents if isinstance(agent, TumAgent))
    keyframes = KeyframeSelectionConfig(translation_m=0.15, rotation_rad=0.15)
    robots = tuple(
        base.model_copy(update={"id": f"agent{i}", "frames": part, "keyframes": keyframes})
        for i, part in enumerate(_FRAMES)
    )
    return gather(scenario.model_copy(update={"agents": robots}))


def read_scenario(name: str, data: Path) -> Scenario:
    """A scenario of the repository with the recordings of a folder."""
    return load_scenario(
        _REPOSITORY / "scenarios" / f"{name}.yaml", os.environ | {"COVINZ_DATA": str(data)}
    )


def chosen(fleet: Fleet, pairs: Set[Pair]) -> dict[str, Jobs]:
    """The jobs of chosen pairs under each profile."""
    return by_pair({profile: jobs_of(fleet, pairs, profile) for profile in ("paper", "fast")})


def recognised(fleet: Fleet) -> dict[str, Jobs]:
    """The jobs that place recognition makes under each profile."""
    return by_pair({profile: fleet.attempts(profile) for profile in ("paper", "fast")})


def by_pair(jobs: Mapping[str, Sequence[LoopJob]]) -> dict[str, Jobs]:
    """Each profile's jobs by query and candidate."""
    return {profile: {(job.query, job.cand): job for job in made} for profile, made in jobs.items()}


def near(data: Path) -> Attempts:
    """`redkitchen`."""
    fleet = redkitchen(data)
    jobs = chosen(fleet, near_pairs(fleet))
    return Attempts(fleet, jobs, Limits(0.5, np.deg2rad(10)), _TRUTH_COVARIANCE)


def far(data: Path) -> Attempts:
    """`redkitchen_elsewhere`."""
    fleet = redkitchen(data)
    jobs = chosen(fleet, far_pairs(fleet))
    return Attempts(fleet, jobs, Limits(0.5, np.deg2rad(10)), _TRUTH_COVARIANCE)


def elsewhere(data: Path) -> Attempts:
    """`elsewhere`."""
    kitchen, scenario = redkitchen(data), read_scenario("fr1_rpy", data)
    robots = tuple(agent.model_copy(update={"id": f"desk-{agent.id}"}) for agent in scenario.agents)
    desk = gather(scenario.model_copy(update={"agents": robots}))
    far_away = frames.transform(np.eye(3), [1000.0, 0.0, 0.0])
    both = Fleet(
        {},
        {**kitchen.keyframes, **desk.keyframes},
        {**kitchen.cameras, **desk.cameras},
        {**kitchen.T_world_body, **{k: far_away @ T for k, T in desk.T_world_body.items()}},
        {},
    )
    jobs = chosen(both, random_pairs(kitchen.keyframes, desk.keyframes, _ELSEWHERE))
    return Attempts(both, jobs, Limits(WRONG_M, WRONG_RAD))


def played(name: str, data: Path) -> Attempts:
    """A scenario of the repository as `covinz run --lockstep` plays it.

    The paper's profile, which takes long, makes every so many of its attempts.
    """
    fleet = gather(read_scenario(name, data))
    jobs = recognised(fleet)
    every = math.ceil(len(jobs["paper"]) / _OF_PAPER)
    some = {pair: job for i, (pair, job) in enumerate(jobs["paper"].items()) if i % every == 0}
    return Attempts(fleet, jobs | {"paper": some}, Limits(WRONG_M, WRONG_RAD))


# The attempts by scenario, and the recordings that they need.
SCENARIOS: Mapping[str, tuple[Callable[[Path], Attempts], tuple[str, ...]]] = {
    "redkitchen": (near, ("redkitchen",)),
    "redkitchen_elsewhere": (far, ("redkitchen",)),
    "elsewhere": (elsewhere, ("redkitchen", "fr1_rpy")),
    "fr1_rpy": (partial(played, "fr1_rpy"), ("fr1_rpy",)),
    "hall": (partial(played, "hall"), ()),
    "courtyard": (partial(played, "courtyard"), ()),
    "machine_hall": (partial(played, "machine_hall"), ("euroc_trajectories",)),
}
DEFAULT_SCENARIOS = ("redkitchen", "redkitchen_elsewhere", "elsewhere", "fr1_rpy", "hall")
