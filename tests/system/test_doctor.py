"""`covinz doctor` and real services: robots with faults, clocks that differ, workers that lack."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from covinz import client, codec, frames, keyexprs
from covinz.agent import Agent
from covinz.doctor import Finding, Verdict, of_robot, of_server
from covinz.doctor.clocks import ask, clock
from covinz.types import Camera, Keyframe, KeyframeContent
from tests.processes import CHECKOUT, PATIENCE_S, Processes
from tests.uploads import CAMERA, features, keyframe

COUNT = 12


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Processes]:
    with Processes(tmp_path) as processes:
        processes.start("router", "ingest", "place_recognition", "optimizer")
        yield processes


def covinz_doctor(endpoint: str, *arguments: str) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-m", "covinz.cli", "doctor", "--endpoint", endpoint, *arguments],
        cwd=CHECKOUT,
        env={**os.environ, "COLUMNS": "200"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=PATIENCE_S,
    )
    return done.returncode, done.stdout


def driven(seq: int, num_features: int = 100, step_m: float = 0.5) -> KeyframeContent:
    """A keyframe of a robot that drives on, stamped now."""
    T_odom_body = frames.transform(np.eye(3), [step_m * seq, 0.0, 0.0])
    return KeyframeContent(time.time_ns(), T_odom_body, CAMERA, features(num_features, seq))


def send(server: Processes, folder: Path, agent: str, contents: list[KeyframeContent]) -> None:
    with Agent(agent, server.endpoint, folder / f"{agent}.sqlite") as robot:
        for content in contents:
            robot.send(content)
        assert robot.wait_delivered(PATIENCE_S)


def upload(server: Processes, kf: Keyframe) -> None:
    """What a program without our Agent may send."""
    for key, message in (
        (keyexprs.agent_camera(kf.id.agent), codec.encode(CAMERA)),
        (keyexprs.agent_keyframe(kf.id.agent), codec.encode(kf)),
    ):
        assert server.bus.ask(key, message)


def about(found: list[Finding], name: str) -> str:
    """What is not good about somebody."""
    return "\n".join(
        f"{one.verdict}: {one.text}"
        for one in found
        if one.text.startswith(name) and one.verdict is not Verdict.GOOD
    )


def test_every_fault_of_a_robot_is_told_and_nobody_elses(server: Processes, tmp_path: Path) -> None:
    day_ns = 86400 * 10**9
    wrong = Camera("PINHOLE", 640, 480, np.array([5.0, 5.0, 319.5, 239.5]), np.eye(4))
    good = [driven(seq) for seq in range(COUNT)]
    send(server, tmp_path, "good", good)
    send(server, tmp_path, "future", [replace(one, stamp_ns=one.stamp_ns + day_ns) for one in good])
    send(
        server, tmp_path, "past", [replace(one, stamp_ns=one.stamp_ns - 9 * day_ns) for one in good]
    )
    send(server, tmp_path, "slow", [replace(one, stamp_ns=one.stamp_ns - 10**11) for one in good])
    for seq in range(2):  # our own Agent refuses that
        upload(server, replace(keyframe(seq, "back"), stamp_ns=time.time_ns() - seq * 10**9))
    send(server, tmp_path, "blind", [driven(seq, num_features=5) for seq in range(COUNT)])
    send(server, tmp_path, "still", [driven(seq, step_m=0.0) for seq in range(COUNT)])
    send(server, tmp_path, "miscalibrated", [replace(good[0], camera=wrong)])
    for x_m in (0.0, 1.0):  # the same name for two keyframes
        T_odom_body = frames.transform(np.eye(3), [x_m, 0.0, 0.0])
        upload(server, replace(keyframe(0, "twin"), T_odom_body=T_odom_body))
    silent = server.bus.declare_alive(keyexprs.agent_alive("silent"))
    client.statuses(server.bus)

    found = list(of_server(server.bus))
    silent.close()
    assert about(found, "good") == ""
    for name, words in (
        ("future", "odd: future: its stamps are 8639"),
        ("past", "odd: past: its stamps are 9 days old"),
        ("slow", "odd: slow: even the quickest of its last keyframes came 10"),
        ("back", "odd: back: 1 keyframes have an older stamp than the one before"),
        ("blind", f"bad: blind: {COUNT} of {COUNT} keyframes have too few features"),
        ("still", f"odd: still: {COUNT - 1} of {COUNT} keyframes have not moved"),
        ("miscalibrated", "odd: miscalibrated: its calibration is odd: focal_length"),
        ("twin", "bad: twin: 1 uploads refused: conflict"),
        ("silent", "odd: silent: no keyframe has come"),
    ):
        assert words in about(found, name), about(found, name)
    assert all(one.advice for one in found if one.verdict is Verdict.BAD)
    assert "loop_solver does not answer" in about(found, "loop_solver")
    # A robot that asks for itself is told the same.
    assert about(list(of_robot(server.bus, "back")), "back") == about(found, "back")


def test_the_exit_code_says_whether_something_is_wrong(server: Processes, tmp_path: Path) -> None:
    code, said = covinz_doctor(server.endpoint)
    assert code == 1
    assert "loop_solver does not answer" in said
    assert "start at least one" in said
    server.start("loop_solver")
    client.wait_idle(server.bus, PATIENCE_S)
    code, said = covinz_doctor(server.endpoint)
    assert code == 0, said
    assert "this program and the server are" in said
    assert "the clocks agree within" in said
    file = tmp_path / "calib.yaml"
    file.write_text("model: PINHOLE\nwidth: 640\nheight: 480\nparams: [500, 500, 10, 240]\n")
    code, said = covinz_doctor(server.endpoint, "--calibration", str(file))
    assert code == 1 and "a principal point at 10, 240" in said


def clock_that_is_wrong(by_s: float) -> int:
    return time.time_ns() + int(by_s * 1e9)


def test_a_clock_that_differs_is_measured(server: Processes) -> None:
    """Ours is wrong, which is the same to see."""
    key = keyexprs.service_status("ingest", "ingest")
    for wrong_s, words in ((-5.0, "ahead of"), (5.0, "behind")):
        found = ask(server.bus, key, PATIENCE_S, partial(clock_that_is_wrong, wrong_s))
        assert found is not None and found.offset_s is not None
        assert abs(found.offset_s + wrong_s) <= found.within_s + 1e-3
        (said,) = clock(found)
        assert said.verdict is Verdict.ODD and words in said.text
