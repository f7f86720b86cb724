"""The load benchmark in small: its robots reach a real server, and its figures are of that."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from benchmarks import load_recordings
from benchmarks.fleet import Fleet as Sent
from benchmarks.load_scaling import AT_ONCE_HZ, upload
from benchmarks.load_server import running_server
from benchmarks.load_uploads import Fleet, measure
from covinz.types import Features, FeatureType, KeyframeId
from tests.contract.examples import EXAMPLES, KEYFRAME

pytestmark = pytest.mark.slow


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    camera = EXAMPLES["Camera"]
    keyframes = {}
    for seq in range(4):
        pixels = rng.integers(0, (camera.width, camera.height), (200, 2)).astype(np.float32)
        descriptors = rng.integers(0, 256, (200, 32), dtype=np.uint8)
        name = KeyframeId("robot", KEYFRAME.id.session, seq)
        keyframes[name] = dataclasses.replace(
            KEYFRAME,
            id=name,
            camera_hash=camera.hash,
            features=Features(FeatureType.ORB, pixels, descriptors),
        )
    folder = tmp_path / "recordings"
    folder.mkdir()
    load_recordings.write(folder, Sent({}, keyframes, {camera.hash: camera}, {}, {}))
    return folder


def test_robots_are_served(recordings: Path, tmp_path: Path) -> None:
    fleet = Fleet(robots=4, rate_hz=5.0, seconds=4.0, workers=1, warm_up_s=1.0, linger_s=0.0)
    made = measure(fleet, recordings, tmp_path / "run")
    assert made["in_log"] == 4 * 5 * 4
    assert made["answers"]["Stored"] == made["in_log"]
    assert made["keyframes_due"] == made["keyframes_accepted"] == 4 * 5 * 3
    assert 0 < made["ack_p50_ms"] <= made["ack_p99_ms"] <= made["ack_max_ms"]
    assert {"router", "ingest", "loop_solver-0", "robots"} < made["cores"].keys()


def test_workers_that_wait_take_part(recordings: Path, tmp_path: Path) -> None:
    with running_server(tmp_path / "run", workers=0, waiting=1) as server:
        upload(server, recordings, AT_ONCE_HZ, robots=2, each=30, out=tmp_path / "out.json")
        server.wait_looked_up(jobs_done=True)
        counters = server.status("place_recognition").counters
        assert counters["rejected.waited"] == server.jobs_done() > 0
