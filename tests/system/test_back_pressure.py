"""Nobody solves anything: robots do not notice, and what is given up says so."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import yaml
from covinz_agents.rendered import RenderedRobot

from covinz import client, codec, keyexprs
from covinz.config import BusConfig
from covinz.types import Keyframe, KeyframeId, Rejection, Stored
from tests.system import test_jobs
from tests.system.test_dead_letters import covinz
from tests.system.test_jobs import SETTINGS, System

pytestmark = pytest.mark.slow

recording, system = test_jobs.recording, test_jobs.system
NUM_KEYFRAMES = 1000
MAX_PENDING_JOBS = 40


@pytest.fixture
def config_file(tmp_path: Path, bus_config: BusConfig) -> Path:
    """A short queue of jobs."""
    path = tmp_path / "config.yaml"
    recognition = {**SETTINGS["place_recognition"], "max_pending_jobs": MAX_PENDING_JOBS}
    settings = {"bus": bus_config.model_dump(mode="json"), "place_recognition": recognition}
    path.write_text(yaml.safe_dump(settings))
    return path


def another(kf: Keyframe, number: int) -> Keyframe:
    """The same keyframe in another run of the robot."""
    name = KeyframeId(kf.id.agent, f"01BX5ZZKBKACTAV9WEVG{number:06d}", kf.id.seq)
    return dataclasses.replace(kf, id=name)


def test_robots_are_served_though_nobody_solves(
    system: System, recording: list[tuple[RenderedRobot, Keyframe]]
) -> None:
    system.start("place_recognition")
    system.place_recognition_at_head(len(recording))
    for number in range(NUM_KEYFRAMES):
        copy, row = divmod(number, len(recording))
        kf = another(recording[row][1], copy)
        (reply,) = system.bus.ask(keyexprs.agent_keyframe(kf.id.agent), codec.encode(kf))
        assert codec.decode_upload_reply(reply) == Stored()

    def sheds() -> bool:
        status = system.status("place_recognition")
        return status is not None and status.counters.get("rejected.shed", 0) > MAX_PENDING_JOBS

    system.until("jobs are given up", sheds)
    status = system.status("place_recognition")
    assert status is not None and status.pending <= MAX_PENDING_JOBS
    assert "rejected.shed=" in covinz(system, "status").stdout
    shed = next(
        record
        for record in client.jobs(system.bus)
        if isinstance(record.outcome, Rejection) and record.outcome.stage == "shed"
    )
    why = covinz(system, "why", str(shed.job.query)).stdout
    assert "shed" in why and f"{MAX_PENDING_JOBS}" in why
    assert shed.job.id in covinz(system, "jobs").stdout
