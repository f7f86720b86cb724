"""The code in the documents runs: every block of it, in order, against a real server.

Python blocks share one namespace per document, in which the robot's own parts are given (`ROBOT`);
whatever address a block names is that of the server of the test. A YAML block is a file that its
first line names; shell blocks run in the folder of these files.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from covinz_agents.layouts import write_asl, write_tum_layout

from covinz import client
from covinz.bus import ZenohBus
from covinz.config import BusConfig
from covinz.run import free_port
from covinz.scenario import load_scenario
from covinz.supervisor import Supervisor, server_specs
from tests.recordings import CAMERAS, RoomRobot

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 240.0
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ADDRESS = re.compile(r"tcp/[\w.]+:7447")
NUM_IMAGES = 24


@dataclass(frozen=True)
class Block:
    """A block of code in a document."""

    language: str
    text: str
    line: int


def blocks(document: Path) -> list[Block]:
    text = document.read_text()
    return [
        Block(match[1], match[2], text.count("\n", 0, match.start(2)) + 1)
        for match in BLOCK.finditer(text)
    ]


def my_images() -> Iterator[tuple[int, Any, Any]]:
    """Time, odometry and image of each frame."""
    robot = RoomRobot(num_frames=NUM_IMAGES)
    for frame in robot.frames:
        yield frame.stamp_ns, frame.T_odom_body, robot.image(frame)


def my_odometry() -> Iterator[tuple[int, Any, Any, Any]]:
    """Time, odometry, keypoints and descriptors of each frame."""
    robot = RoomRobot(num_frames=6)
    for frame in robot.frames:
        features = robot.features(frame)
        yield frame.stamp_ns, frame.T_odom_body, features.keypoints_px, features.descriptors


def robot_parts() -> dict[str, Any]:
    """What a document may take for granted: the names of a robot's own parts."""
    camera = CAMERAS["OPENCV"]
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
    return {
        **dict(zip(names, camera.params.tolist(), strict=True)),
        "T_body_cam": np.array(camera.T_body_cam),
        "my_images": my_images,
        "my_odometry": my_odometry,
    }


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[str]:
    """A whole server on a free port."""
    address = f"tcp/127.0.0.1:{free_port()}"
    config_file = tmp_path / "server.yaml"
    config_file.write_text(yaml.safe_dump({"bus": {"endpoint": address}}))
    data = tmp_path / "server"
    data.mkdir()
    with Supervisor(server_specs(config_file, data, workers=1), tmp_path / "logs"):
        bus = ZenohBus.open(BusConfig(endpoint=address))
        try:
            client.wait_idle(bus, timeout_s=PATIENCE_S)
            yield address
        finally:
            bus.close()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the blocks run: the reader's current directory, with recordings in it."""
    reader = tmp_path / "reader"
    write_tum_layout(reader / "recordings" / "kitchen", RoomRobot(num_frames=NUM_IMAGES))
    write_asl(reader / "recordings" / "flight", RoomRobot(num_frames=NUM_IMAGES))
    monkeypatch.chdir(reader)
    return reader


def keyframes_of(endpoint: str) -> dict[str, int]:
    """How many keyframes each agent has in a map."""
    bus = ZenohBus.open(BusConfig(endpoint=endpoint))
    try:
        client.wait_idle(bus, timeout_s=PATIENCE_S)
        counts: dict[str, int] = {}
        for snapshot in client.snapshots(bus):
            for keyframe in snapshot.keyframes:
                counts[keyframe.agent] = counts.get(keyframe.agent, 0) + 1
        return counts
    finally:
        bus.close()


def run_python(block: Block, document: Path, endpoint: str, names: dict[str, Any]) -> None:
    text = ADDRESS.sub(endpoint, block.text)
    # So that a traceback names the line of the document.
    code = compile("\n" * (block.line - 1) + text, str(document), "exec")
    exec(code, names)


def run_shell(block: Block, endpoint: str) -> str:
    """What the commands say; they are those of this environment."""
    tools = Path(sys.executable).parent
    environment = os.environ | {
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "COVINZ__BUS__ENDPOINT": endpoint,
    }
    ended = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.text],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=PATIENCE_S,
    )
    assert ended.returncode == 0, f"line {block.line}:\n{ended.stdout[-3000:]}"
    return ended.stdout


def test_the_python_of_the_readme_runs(endpoint: str, folder: Path) -> None:
    names = robot_parts()
    found = [block for block in blocks(ROOT / "README.md") if block.language == "python"]
    assert found
    for block in found:
        run_python(block, ROOT / "README.md", endpoint, names)
    assert sum(keyframes_of(endpoint).values()) >= 3


def test_the_guide_for_agents_runs(endpoint: str, folder: Path) -> None:
    document = ROOT / "docs" / "agents.md"
    names, said = robot_parts(), []
    for block in blocks(document):
        match block.language:
            case "python":
                run_python(block, document, endpoint, names)
            case "yaml":
                file = folder / block.text.splitlines()[0].removeprefix("# ")
                file.write_text(block.text)
                load_scenario(file)
            case "sh":
                said.append(run_shell(block, endpoint))
            case other:
                pytest.fail(f"{document}:{block.line}: nobody runs {other!r}")
    counts = keyframes_of(endpoint)
    assert counts["robot-1"] == 12 + 3 * NUM_IMAGES
    assert counts["robot-2"] == 1
    assert names["T_map_body"].shape == (4, 4)
    spool, status = said[0], said[1]
    assert "refused by the server: 1" in spool and "1 keyframes go with the next run" in spool
    assert "idle" in status or "at work" in status
    assert (folder / "runs" / "kitchen" / "report.json").is_file()
    assert (folder / "runs" / "recorded" / "report.json").is_file()
