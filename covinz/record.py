"""What a run leaves to evaluate: the server's answers, the player's summary, ground truth, plan."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from covinz import client, evaluation
from covinz.bus import Bus
from covinz.config import OptimizerConfig
from covinz.scenario import Scenario, groundtruth
from covinz.trajectory import Trajectory
from covinz.types import Array, JobRecord, KeyframeId, MapSnapshot

PLAN_FILE = "plan.json"


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """What was left to evaluate when the server became idle.

    Attributes:
        snapshots: Every map, oldest first.
        jobs: Every job with its outcome.
        played: The player's summary: per agent session, keyframes, bytes, duration_s.
        groundtruth: True body poses by agent, for those that have any.
        server_s: From the first keyframe until the server was idle.
        name: Name of the scenario.
        plan: (K, 2) outlines of what stands in the world, as seen from above [m, world frame];
            empty where the world is not a generated one. A world with a plan has z up.
        cauchy_scale: Scale of the optimizer's Cauchy loss, in sigmas.
    """

    snapshots: Sequence[MapSnapshot]
    jobs: Sequence[JobRecord]
    played: Mapping[str, Any]
    groundtruth: Mapping[str, Trajectory]
    server_s: float
    name: str = "run"
    plan: Sequence[Array] = ()
    cauchy_scale: float = OptimizerConfig().cauchy_scale

    def true_poses(self) -> dict[KeyframeId, Array]:
        """True T_world_body of every keyframe that has ground truth."""
        poses = {}
        for snapshot in self.snapshots:
            for keyframe, stamp in zip(snapshot.keyframes, snapshot.stamps_ns, strict=True):
                truth = self.groundtruth.get(keyframe.agent)
                T = truth.at(int(stamp), evaluation.MAX_GAP_NS) if truth is not None else None
                if T is not None:
                    poses[keyframe] = T
        return poses


def collect(
    bus: Bus,
    scenario: Scenario,
    played: Mapping[str, Any],
    folder: Path,
    server_s: float,
    cauchy_scale: float,
) -> RunRecord:
    """Ask an idle server, and the run's folder, for everything that report and pictures need.

    Raises:
        TrajectoryError, ConfigError: As `groundtruth` does.
    """
    truths = {agent.id: groundtruth(scenario, agent.id, folder) for agent in scenario.agents}
    return RunRecord(
        client.snapshots(bus),
        list(client.jobs(bus)),
        played,
        {agent: truth for agent, truth in truths.items() if truth is not None},
        server_s,
        scenario.name,
        read_plan(folder),
        cauchy_scale,
    )


def read_plan(folder: Path) -> tuple[Array, ...]:
    """The plan that the player left in a run's folder; empty if it left none.

    Raises:
        ValueError, KeyError: If the file is not what a player writes.
    """
    file = folder / PLAN_FILE
    if not file.is_file():
        return ()
    polygons = json.loads(file.read_text())["polygons_m"]
    return tuple(np.asarray(polygon, dtype=float).reshape(-1, 2) for polygon in polygons if polygon)
