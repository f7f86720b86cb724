"""A robot whose odometry begins anew in mid-run: loops join what it drove before and after."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from covinz_agents.player import keyframe_content
from covinz_agents.staging import Part, stage

from covinz import client, evaluation, frames
from covinz.agent import Agent
from covinz.bus import ZenohBus
from covinz.config import BusConfig
from covinz.run import free_port
from covinz.scenario import load_scenario
from covinz.supervisor import Supervisor, server_specs
from covinz.trajectory import Trajectory
from covinz.types import Array, KeyframeContent, KeyframeId, MapSnapshot

pytestmark = pytest.mark.slow

SMALL = Path(__file__).with_name("small.yaml")
PATIENCE_S = 240.0


@dataclass(frozen=True)
class Sent:
    """What a robot has sent, with the pose that its odometry had then."""

    id: KeyframeId
    T_odom_body: Array


def drive(part: Part, send: Callable[[KeyframeContent], KeyframeId], reset: object) -> list[Sent]:
    """Send all keyframes; with `reset`, odometry starts again from nothing in the middle."""
    contents = [keyframe_content(part, frame) for frame in part.keyframes]
    middle = len(contents) // 2
    sent = []
    for number, content in enumerate(contents):
        if callable(reset) and number >= middle:
            if number == middle:
                reset()
            start = contents[middle].T_odom_body
            anew = frames.inverse(start) @ content.T_odom_body
            content = replace(content, T_odom_body=anew, covariance=None)
        sent.append(Sent(send(content), content.T_odom_body))
    return sent


def errors_m(snapshot: MapSnapshot, parts: list[Part]) -> dict[str, float]:
    """Error of each session in the map [m], all aligned with the truth at once."""
    rows = defaultdict(list)
    for row, keyframe in enumerate(snapshot.keyframes):
        rows[keyframe.segment].append(row)
    truth = {part.id: part.source.groundtruth for part in parts}
    pairs = {}
    for segment, unordered in rows.items():
        of = sorted(unordered, key=lambda row: snapshot.stamps_ns[row])
        groundtruth = truth[segment.agent]
        assert groundtruth is not None
        estimate = Trajectory(snapshot.stamps_ns[of], snapshot.T_map_body[of])
        pairs[str(segment)] = evaluation.associate(estimate, groundtruth)
    T_ref_map = evaluation.alignment(list(pairs.values()))
    return {
        name: evaluation.rmse(evaluation.position_errors(pair, T_ref_map))
        for name, pair in pairs.items()
    }


def test_both_segments_end_in_one_map(tmp_path: Path) -> None:
    scenario = load_scenario(SMALL)
    parts = stage(scenario, tmp_path, threading.Event(), lambda done, of: None)
    bus_config = BusConfig(endpoint=f"tcp/127.0.0.1:{free_port()}")
    config_file = tmp_path / "server.yaml"
    settings = {"bus": {"endpoint": bus_config.endpoint}, **scenario.config}
    config_file.write_text(yaml.safe_dump(settings))
    data = tmp_path / "server"
    data.mkdir()
    with Supervisor(server_specs(config_file, data, workers=1), tmp_path / "logs"):
        bus = ZenohBus.open(bus_config)
        first, second = parts
        with (
            Agent(first.id, bus_config.endpoint, tmp_path / "first.sqlite") as robot,
            Agent(second.id, bus_config.endpoint, tmp_path / "second.sqlite") as other,
        ):
            sent = drive(first, robot.send, robot.new_session)
            drive(second, other.send, None)
            assert robot.wait_delivered(PATIENCE_S) and other.wait_delivered(PATIENCE_S)
            client.wait_idle(bus, timeout_s=PATIENCE_S)
            (snapshot,) = client.snapshots(bus)
            T_map_odom = robot.T_map_odom
        bus.close()

    segments = {keyframe.segment for keyframe in snapshot.keyframes}
    assert sorted(segment.agent for segment in segments) == [first.id, first.id, second.id]
    assert len(snapshot.keyframes) == len(first.keyframes) + len(second.keyframes)
    # The sessions are where they belong, though odometry knows nothing of how they lie.
    errors = errors_m(snapshot, parts)
    assert max(errors.values()) < 0.3, errors
    # What the robot is told is of the session that it is in.
    assert T_map_odom is not None
    row = snapshot.keyframes.index(sent[-1].id)
    told = frames.local_error(T_map_odom @ sent[-1].T_odom_body, snapshot.T_map_body[row])
    assert np.linalg.norm(told) < 0.1
