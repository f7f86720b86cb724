"""Robots that send other features than each other, over real services: who meets, and why not."""

from __future__ import annotations

import math
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml
from covinz_agents.rendered import RenderedRobot
from covinz_agents.selection import select_keyframes
from covinz_agents.source import Frame

from covinz import client, codec, frames, keyexprs
from covinz.bus import ZenohBus
from covinz.config import BusConfig
from covinz.scenario import RenderedAgent, Scenario
from covinz.types import (
    Duplicate,
    Features,
    JobRecord,
    JobState,
    Keyframe,
    KeyframeId,
    LoopClosure,
    Rejection,
    Stored,
)
from tests.small_world import CAMERA, SCENE, arc

pytestmark = pytest.mark.slow

PATIENCE_S = 120.0
NUM_KEYFRAMES = 8
SETTINGS = {
    "place_recognition": {"num_candidates": 2, "other_agents_only": True},
    "loop_solver": {"max_rig_iterations": 300, "num_covariance_samples": 10},
}
StartProcess = Callable[..., subprocess.Popen[str]]
# The blocks that keyframe `seq` of an agent is sent with, of its ORB and its SIFT.
Choice = Callable[[str, int, Features, Features], tuple[Features, ...]]


@pytest.fixture(params=["fast", "paper"])
def config_file(tmp_path: Path, bus_config: BusConfig, request: pytest.FixtureRequest) -> Path:
    """The endpoint of this test and settings for short jobs, with either profile."""
    solver = {**SETTINGS["loop_solver"], "profile": request.param}
    settings = {"bus": bus_config.model_dump(mode="json"), **SETTINGS, "loop_solver": solver}
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


@dataclass(frozen=True)
class Robot:
    """A rendered robot, and what each of its keyframes shows by ORB and by SIFT."""

    source: RenderedRobot
    id: str
    frames: list[Frame]
    features: list[tuple[Features, ...]]

    def keyframes(self, choice: Choice) -> Iterator[Keyframe]:
        """Its keyframes with the features chosen."""
        session = f"01ARZ3NDEKTSV4RRFFQ69G5FA{self.id[-1]}"
        for seq, (frame, blocks) in enumerate(zip(self.frames, self.features, strict=True)):
            features, *more = choice(self.id, seq, *blocks)
            yield Keyframe(
                KeyframeId(self.id, session, seq),
                frame.stamp_ns,
                frame.T_odom_body,
                self.source.camera.hash,
                features,
                more_features=tuple(more),
            )


@pytest.fixture(scope="module")
def robots() -> list[Robot]:
    """Two robots on one way, one behind the other."""
    entries = [
        {
            "id": f"agent{number}",
            "reader": "rendered",
            "camera": CAMERA,
            "path": arc(0.15 * number, math.pi, 2.0 * number),
            "keyframes": {"translation_m": 0.3, "rotation_rad": 0.25},
            "features": {"kinds": ["orb", "sift"], "num_features": 600},
        }
        for number in range(2)
    ]
    scenario = Scenario.model_validate({"name": "kinds", "scene": SCENE, "agents": entries})
    made = []
    for agent in scenario.agents:
        assert isinstance(agent, RenderedAgent)
        source = RenderedRobot(agent, scenario)
        chosen = select_keyframes(source.frames, agent.keyframes)[:NUM_KEYFRAMES]
        features = [source.all_features(frame) for frame in chosen]
        made.append(Robot(source, agent.id, chosen, features))
    return made


@pytest.fixture
def solved(
    robots: list[Robot], start_service: StartProcess, open_bus: Callable[[], ZenohBus]
) -> Callable[[Choice], list[JobRecord]]:
    """Upload both robots' keyframes with the features chosen; all jobs, once they are done."""

    def solve(choice: Choice) -> list[JobRecord]:
        for name in ("router", "ingest", "optimizer", "place_recognition", "loop_solver"):
            start_service(name)
        bus = open_bus()
        assert bus.wait_connected(PATIENCE_S)
        wait_for("ingest is up", lambda: bool(client.statuses(bus, "ingest")))
        for robot in robots:
            upload(bus, keyexprs.agent_camera(robot.id), codec.encode(robot.source.camera))
            for kf in robot.keyframes(choice):
                upload(bus, keyexprs.agent_keyframe(robot.id), codec.encode(kf))
        head = sum(len(robot.frames) for robot in robots)
        wait_for("all jobs are done", lambda: at_rest(bus, head))
        return list(client.jobs(bus))

    return solve


def wait_for(what: str, holds: Callable[[], bool]) -> None:
    """Wait for a state that processes only tell when asked."""
    deadline, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while not holds():
        assert time.monotonic() < deadline, f"timed out: {what}"
        pause.wait(0.05)


def at_rest(bus: ZenohBus, head: int) -> bool:
    return any(
        (status.cursor, status.pending, status.leased) == (head, 0, 0)
        for status in client.statuses(bus, "place_recognition")
    )


def upload(bus: ZenohBus, key: str, payload: bytes) -> None:
    (reply,) = bus.ask(key, payload)
    assert isinstance(codec.decode_upload_reply(reply), Stored | Duplicate)


def loops_of(records: list[JobRecord], robots: list[Robot]) -> list[LoopClosure]:
    """The accepted loops, all of which must be true."""
    truth = {
        (robot.id, seq): robot.source.groundtruth.T_ref_body[
            np.searchsorted(robot.source.groundtruth.stamps_ns, frame.stamp_ns)
        ]
        for robot in robots
        for seq, frame in enumerate(robot.frames)
    }
    loops = [r.outcome for r in records if isinstance(r.outcome, LoopClosure)]
    for loop in loops:
        T_world_cand = truth[loop.cand.agent, loop.cand.seq]
        T_world_query = truth[loop.query.agent, loop.query.seq]
        true = frames.inverse(T_world_cand) @ T_world_query
        error = frames.local_error(true, loop.T_cand_query)
        assert np.linalg.norm(error[3:]) < 0.3
        assert np.rad2deg(np.linalg.norm(error[:3])) < 8
    return loops


def test_robots_with_sift_meet_one_that_sends_both(
    solved: Callable[[Choice], list[JobRecord]], robots: list[Robot]
) -> None:
    def choice(agent: str, seq: int, orb: Features, sift: Features) -> tuple[Features, ...]:
        return (orb, sift) if agent == "agent0" else (sift,)

    records = solved(choice)
    assert all(record.state is JobState.DONE for record in records)
    assert len(loops_of(records, robots)) >= 3


def test_rigs_without_a_common_kind_are_rejected_with_that_reason(
    solved: Callable[[Choice], list[JobRecord]],
) -> None:
    """Every second keyframe of agent0 lacks the ORB by which agent1 recognises the place."""

    def choice(agent: str, seq: int, orb: Features, sift: Features) -> tuple[Features, ...]:
        return (sift,) if agent == "agent0" and seq % 2 else (orb,)

    records = solved(choice)
    assert len(records) >= 3
    for record in records:
        assert record.state is JobState.DONE
        assert isinstance(record.outcome, Rejection)
        assert record.outcome.stage == "feature_kind"
        assert "no kind in common" in record.outcome.detail
