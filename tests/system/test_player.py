"""The player against a real router and a real ingest: delivery, order, exit codes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
import yaml

from covinz import codec, keyexprs
from covinz.scenario import groundtruth, load_scenario
from covinz.types import Keyframe, LogHead, LogView
from tests.processes import CHECKOUT, PATIENCE_S, Processes
from tests.small_world import CAMERA, SCENE, arc

SCENARIO: dict[str, Any] = {
    "name": "small",
    "scene": SCENE,
    "defaults": {
        "reader": "rendered",
        "camera": CAMERA,
        "features": {"num_features": 200},
        "keyframes": {"translation_m": 0.4, "rotation_rad": 0.4},
    },
    "agents": [
        {"id": "b", "path": arc(0.0, 1.9)},
        {"id": "a", "path": arc(0.0, -2.5)},
    ],
}


class Growth:
    """Waits for the log to grow."""

    def __init__(self, server: Processes) -> None:
        self._changed = threading.Condition()
        self._head = 0
        server.bus.subscribe(keyexprs.LOG_HEAD, self._on_head)

    def wait_for(self, head: int) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: self._head >= head, PATIENCE_S), self._head

    def _on_head(self, _: str, payload: bytes) -> None:
        with self._changed:
            self._head = codec.decode(payload, LogHead).head
            self._changed.notify_all()


def scenario_file(folder: Path, **changes: object) -> Path:
    path = folder / "small.yaml"
    path.write_text(yaml.safe_dump(SCENARIO | changes))
    return path


def start_player(folder: Path, endpoint: str, *options: str) -> subprocess.Popen[str]:
    argv = [sys.executable, "-m", "covinz_agents.play", str(folder / "small.yaml")]
    argv += ["--endpoint", endpoint, "--spool", str(folder / "spool"), "--no-progress", *options]
    return subprocess.Popen(argv, cwd=CHECKOUT, stderr=subprocess.PIPE, text=True)


def played(folder: Path, endpoint: str, *options: str) -> tuple[int, str]:
    """Exit code and messages of a player that ends by itself."""
    player = start_player(folder, endpoint, *options)
    _, messages = player.communicate(timeout=PATIENCE_S)
    return player.returncode, messages


def keyframes(server: Processes) -> list[Keyframe]:
    items = [entry.item for entry in server.log_entries(LogView.FULL)]
    return [item for item in items if isinstance(item, Keyframe)]


def lockstep_log(folder: Path) -> list[bytes]:
    """The log that a lockstep run on a fresh server leaves."""
    folder.mkdir()
    scenario_file(folder)
    with Processes(folder) as server:
        server.start("router", "ingest")
        assert played(folder, server.endpoint, "--lockstep") == (0, "")
        return [codec.encode(keyframe) for keyframe in keyframes(server)]


def test_lockstep_sends_in_stamp_order_and_leaves_the_same_log_every_time(
    tmp_path: Path,
) -> None:
    first, second = lockstep_log(tmp_path / "first"), lockstep_log(tmp_path / "second")
    assert first == second
    sent = [codec.decode(payload, Keyframe) for payload in first]
    order = [(keyframe.stamp_ns, keyframe.id.agent) for keyframe in sent]
    assert order == sorted(order)
    assert {keyframe.id.agent for keyframe in sent} == {"a", "b"}


def test_a_run_delivers_everything_and_sums_it_up(tmp_path: Path) -> None:
    path = scenario_file(tmp_path)
    with Processes(tmp_path) as server:
        server.start("router", "ingest")
        summary_file = tmp_path / "results" / "agents.json"
        assert played(tmp_path, server.endpoint, "--summary", str(summary_file)) == (0, "")
        stored = keyframes(server)
    summary = json.loads(summary_file.read_text())
    assert set(summary["agents"]) == {"a", "b"}
    for agent, figures in summary["agents"].items():
        mine = [keyframe for keyframe in stored if keyframe.id.agent == agent]
        assert sorted(keyframe.id.seq for keyframe in mine) == list(range(figures["keyframes"]))
        assert {keyframe.id.session for keyframe in mine} == {figures["session"]}
        assert figures["bytes"] > 200 * 36 * len(mine) * 0.5
        assert figures["rejected"] == 0
        assert figures["duration_s"] > 3
        truth = groundtruth(load_scenario(path), agent, summary_file.parent)
        assert truth is not None
        assert all(truth.at(keyframe.stamp_ns, 0) is not None for keyframe in mine)


def test_a_server_that_dies_and_comes_back_loses_nothing(tmp_path: Path) -> None:
    scenario_file(tmp_path)
    with Processes(tmp_path) as server:
        server.start("router", "ingest")
        growth = Growth(server)
        player = start_player(
            tmp_path, server.endpoint, "--rate", "4", "--summary", str(tmp_path / "s.json")
        )
        growth.wait_for(4)
        server.kill("ingest")
        server.start("ingest")
        _, messages = player.communicate(timeout=PATIENCE_S)
        assert player.returncode == 0, messages
        agents = json.loads((tmp_path / "s.json").read_text())["agents"]
        assert len(keyframes(server)) == sum(f["keyframes"] for f in agents.values())


def test_it_gives_up_on_a_server_that_never_acknowledges(tmp_path: Path) -> None:
    scenario_file(tmp_path)
    with Processes(tmp_path) as server:
        server.start("router")
        code, messages = played(tmp_path, server.endpoint, "--patience", "0.5")
    assert code == 1
    assert "acknowledged nothing" in messages
    assert sorted(path.name for path in (tmp_path / "spool").glob("*.sqlite")) == [
        "a.sqlite",
        "b.sqlite",
    ]


def test_it_stops_when_asked(tmp_path: Path) -> None:
    scenario_file(tmp_path)
    with Processes(tmp_path) as server:
        server.start("router", "ingest")
        growth = Growth(server)
        player = start_player(tmp_path, server.endpoint, "--rate", "0.01")
        growth.wait_for(2)
        player.send_signal(signal.SIGTERM)
        _, messages = player.communicate(timeout=PATIENCE_S)
    assert player.returncode == 1
    assert "stopped" in messages


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"agents": []}, "small.yaml"),
        (
            {
                "defaults": {
                    "reader": "tum",
                    "path": "/nowhere",
                    "odometry": {"source": "file", "file": "o.tum", "frame": "body"},
                },
                "agents": [{"id": "a"}],
            },
            "/nowhere/rgb.txt",
        ),
    ],
)
def test_a_scenario_that_cannot_be_played_is_explained(
    tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    scenario_file(tmp_path, **changes)
    code, messages = played(tmp_path, "tcp/127.0.0.1:1")
    assert code == 2
    assert message in messages
    assert "Traceback" not in messages
