"""What the benchmark of feature kinds plays and keeps."""

from __future__ import annotations

import yaml

from benchmarks.feature_kinds import _KINDS, _SCENARIO, figures
from covinz.scenario import load_scenario


def test_the_scenario_has_robots_that_any_kind_can_be_set_for() -> None:
    scenario = yaml.safe_load(_SCENARIO.read_text())
    assert not any("features" in agent for agent in scenario["agents"])
    assert [agent.features.kinds for agent in load_scenario(_SCENARIO, {}).agents] == [
        tuple(_KINDS["sift"])
    ] * 2


def test_bytes_are_per_keyframe() -> None:
    report = {
        "agents": {
            "near": {"keyframes": 3, "bytes": 400_000},
            "far": {"keyframes": 1, "bytes": 120_000},
        },
        "loops": {"candidates": 9, "accepted": 4, "wrong": 0},
        "maps": [["far", "near"]],
        "joint_ate_before_m": 0.05,
        "joint_ate_after_m": 0.03,
        "solver_ms": {"median": 10.0, "p95": 20.0},
        "wall_s": 100.0,
    }
    kept = figures(report)
    assert (kept["keyframes"], kept["kB_per_keyframe"]) == (4, 130.0)
    assert kept["loops"]["accepted"] == 4
    assert "wall_s" not in kept
