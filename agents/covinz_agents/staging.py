"""What is done before a scenario is played: robots opened, keyframes chosen, images rendered."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from covinz.record import PLAN_FILE
from covinz.scenario import (
    Agent,
    AslAgent,
    DriftingGroundTruth,
    RenderedAgent,
    Scenario,
    TumAgent,
    generated_groundtruth_file,
)
from covinz.trajectory import write_tum
from covinz.types import Array
from covinz_agents.asl import AslRecording
from covinz_agents.drift import keyframe_covariances
from covinz_agents.selection import select_keyframes
from covinz_agents.source import DatasetError, Frame, Source
from covinz_agents.tum import TumRecording

# Called with images rendered so far and images to render.
OnRendering = Callable[[int, int], None]
R = TypeVar("R", TumAgent, AslAgent)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A robot that is ready to be played.

    Attributes:
        id: Its agent id.
        source: Where its frames come from.
        keyframes: Frames that it sends.
        covariance: By frame number, (6, 6) of the motion since the keyframe before; empty where
            the odometry does not know how good it is.
    """

    id: str
    source: Source
    keyframes: Sequence[Frame]
    covariance: Mapping[int, Array]


def open_source(agent: Agent, scenario: Scenario) -> Source:
    """The recording or the rendered robot of an agent of a scenario.

    Raises:
        DatasetError, TrajectoryError, ConfigError: As those classes do, and if this machine has
            not what rendering needs.
    """
    match agent:
        case TumAgent():
            return TumRecording(_seeded(agent, scenario.seed))
        case AslAgent():
            return AslRecording(_seeded(agent, scenario.seed))
        case RenderedAgent():
            return _rendered(agent, scenario)


def stage(
    scenario: Scenario, results: Path, stop: threading.Event, on_rendering: OnRendering
) -> list[Part]:
    """Make all robots of a scenario ready.

    Leaves the ground truth of rendered robots and the plan of their world in a folder, and their
    images in the cache.

    Args:
        scenario: Whose robots.
        results: The folder.
        stop: Ends rendering early when set.
        on_rendering: Called while images are rendered.

    Raises:
        RenderingStopped: If `stop` was set.
        DatasetError, TrajectoryError, ConfigError: If a robot cannot be played.
    """
    parts = [_part(agent, open_source(agent, scenario)) for agent in scenario.agents]
    if any(isinstance(agent, RenderedAgent) for agent in scenario.agents):
        _render(scenario, parts, results, stop, on_rendering)
    return parts


def _part(agent: Agent, source: Source) -> Part:
    source.camera  # noqa: B018 - a recording without calibration must fail before anything is sent
    keyframes = select_keyframes(source.frames, agent.keyframes)
    covariance: dict[int, Array] = {}
    if isinstance(agent.odometry, DriftingGroundTruth):
        rows = {frame.number: row for row, frame in enumerate(source.frames)}
        stated = keyframe_covariances(
            np.array([frame.T_odom_body for frame in source.frames]),
            [rows[frame.number] for frame in keyframes],
            agent.odometry.drift,
        )
        pairs = zip(keyframes, stated, strict=True)
        covariance = {frame.number: known for frame, known in pairs if known is not None}
    return Part(agent.id, source, keyframes, covariance)


def _seeded(agent: R, seed: int) -> R:
    """A recording whose drift, if any, has the scenario's seed added."""
    if not isinstance(agent.odometry, DriftingGroundTruth):
        return agent
    drift = agent.odometry.drift
    drift = drift.model_copy(update={"seed": drift.seed + seed})
    odometry = agent.odometry.model_copy(update={"drift": drift})
    return agent.model_copy(update={"odometry": odometry})


def _rendered(agent: RenderedAgent, scenario: Scenario) -> Source:
    # Robots are installed without what draws worlds.
    try:
        from covinz_agents.rendered import RenderedRobot
    except ImportError as error:
        raise DatasetError(
            f"{agent.id} is rendered, for which {error.name} is missing: install "
            "covinz_agents[world]"
        ) from error
    return RenderedRobot(agent, scenario)


def _render(
    scenario: Scenario,
    parts: Sequence[Part],
    results: Path,
    stop: threading.Event,
    on_rendering: OnRendering,
) -> None:
    """Leave truth and plan, then see to it that all images are there."""
    from covinz_agents.rendered import RenderedRobot, world_of
    from covinz_agents.rendering import render_ahead
    from covinz_agents.world.plan import plan

    results.mkdir(parents=True, exist_ok=True)
    polygons = [polygon.tolist() for polygon in plan(world_of(scenario))]
    (results / PLAN_FILE).write_text(json.dumps({"polygons_m": polygons}) + "\n")
    robots = {}
    for part in parts:
        if isinstance(part.source, RenderedRobot):
            robots[part.id] = (part.source, part.keyframes)
            path = generated_groundtruth_file(part.id, results)
            write_tum(path, part.source.groundtruth, f"exact T_world_body of {part.id}")
    render_ahead(scenario, robots, stop, on_rendering)
