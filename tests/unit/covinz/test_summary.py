"""What `covinz run` says at its end, word for word and in 80 columns."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from covinz import summary

FILES = [Path("runs/hall/report.json"), Path("runs/hall/top_view.png"), Path("runs/hall/map.g2o")]


def made(**changes: Any) -> dict[str, Any]:
    agents = {
        "agent0": {"keyframes": 37, "path_m": 15.3, "kB_per_s": 39.6},
        "agent1": {"keyframes": 104, "path_m": 2415.0, "kB_per_s": 41.2},
    }
    errors = {"ate_before_m": 0.65, "ate_after_m": 0.027}
    report = {
        "scenario": "hall",
        "agents": {name: agent | errors for name, agent in agents.items()},
        "maps": [["agent0", "agent1"]],
        "joint_ate_before_m": 0.65,
        "joint_ate_after_m": 0.2,
        "loops": {
            "candidates": 175,
            "accepted": 154,
            "intra": 28,
            "inter": 126,
            "with_groundtruth": 154,
            "wrong": 3,
            "wrong_effective": 2,
            "wrong_bending": 0,
            "t_err_max_m": 1.42,
        },
        "keyframes_lost": 0,
        "wall_s": 42.3,
        "phases_s": {"start": 1.7, "play": 3.71, "drain": 36.0, "stop": 0.5, "evaluate": 0.0},
    }
    return report | changes


def shown(report: dict[str, Any], files: list[Path] = FILES, **options: Any) -> str:
    stream = io.StringIO()
    console = Console(file=stream, width=80, **options)
    summary.show(console, report, Path("runs/hall"), files)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines())


def test_the_summary_of_a_good_run() -> None:
    assert (
        shown(made())
        == """
hall: one map of 2 robots
robot    keyframes       path   kB/s   ATE alone   ATE in the map
─────────────────────────────────────────────────────────────────
agent0          37     15.3 m     40     65.0 cm           2.7 cm
agent1         104   2415.0 m     41     65.0 cm           2.7 cm

maps       agent0 agent1
loops      154 of 175 candidates: 28 within a robot, 126 between robots
wrong      3 loops (1.9 %), none bends the map; the worst is off by 1.42 m
joint ATE  65.0 cm (each odometry aligned alone) → 20.0 cm, 3.2 times better
lost       no keyframe
time       42 s (start 1.7, play 3.7, drain 36.0, stop 0.5, evaluate 0.0)

runs/hall/
  top_view.png  odometry alone and the map, from above
  report.json   all figures
  map.g2o       the pose graph

ask why:  covinz why agent0/0 --run runs/hall
read on:  docs/architecture.md"""
    )


def test_a_pipe_gets_no_colours_and_a_terminal_does() -> None:
    assert "\x1b[" not in shown(made())
    assert "\x1b[" in shown(made(), force_terminal=True, color_system="standard")


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"maps": [["agent0"], ["agent1"]]}, "hall: 2 maps of 2 robots"),
        ({"maps": [["agent0"], ["agent1"]]}, "maps       agent0; agent1"),
        ({"maps": []}, "hall: no map of 2 robots"),
        ({"keyframes_lost": 5}, "lost       5 keyframes"),
        ({"joint_ate_after_m": None}, "joint ATE  unknown: there is no ground truth"),
        (
            {"joint_ate_after_m": 1.3},
            "joint ATE  65.0 cm (each odometry aligned alone) → 1.30 m, 2.0 times worse",
        ),
        (
            {"loops": made()["loops"] | {"wrong": 0}},
            "wrong      none; the worst is off by 1.42 m",
        ),
        (
            {"loops": made()["loops"] | {"wrong_bending": 2}},
            "wrong      3 loops (1.9 %), 2 bend the map; the worst is off by 1.42 m",
        ),
    ],
)
def test_what_is_not_as_it_should_be_is_said(changes: dict[str, Any], line: str) -> None:
    assert line in shown(made(**changes)).splitlines()


def test_a_server_that_was_only_asked_has_no_times_and_blind_loops_no_errors() -> None:
    report = made(loops=made()["loops"] | {"wrong": None, "wrong_bending": None})
    del report["phases_s"]
    words = [line.split(" ")[0] for line in shown(report).splitlines()]
    assert "time" not in words
    assert "wrong" not in words


def test_five_robots_with_long_names_fit() -> None:
    agent = made()["agents"]["agent1"]
    report = made(agents={"inspection-robot-of-the-east-" + str(i): agent for i in range(5)})
    lines = shown(report).splitlines()
    assert max(map(len, lines)) <= 80
    assert sum("2415.0 m" in line for line in lines) == 5


def test_a_run_outside_of_the_current_folder_is_named_in_full(tmp_path: Path) -> None:
    stream = io.StringIO()
    console = Console(file=stream, width=200)
    summary.show(console, made(), tmp_path, [tmp_path / "report.json"])
    assert f"--run {tmp_path}" in stream.getvalue()
