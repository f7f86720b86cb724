"""The figures of a run against values worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from covinz import frames, report
from covinz.record import RunRecord
from covinz.trajectory import Trajectory
from covinz.types import (
    JobRecord,
    JobState,
    KeyframeId,
    LoopClosure,
    LoopJob,
    MapSnapshot,
    MapSummary,
    Outcome,
    Rejection,
    RigMember,
    SegmentId,
)

SESSIONS = {"a": "0" * 25 + "A", "b": "0" * 25 + "B"}
SECOND = 1_000_000_000


def kf(agent: str, seq: int) -> KeyframeId:
    return KeyframeId(agent, SESSIONS[agent], seq)


def pose(x: float, y: float = 0.0, yaw_rad: float = 0.0) -> np.ndarray:
    return frames.transform(frames.so3_exp([0.0, 0.0, yaw_rad]), [x, y, 0.0])


def job(outcome: Outcome) -> JobRecord:
    rigs = [(RigMember(found, np.eye(4), "0" * 16),) for found in (outcome.query, outcome.cand)]
    made = LoopJob(outcome.job_id, rigs[0], rigs[1], 10.0)
    return JobRecord(made, JobState.DONE, 1, outcome)


def loop(query: KeyframeId, cand: KeyframeId, T: np.ndarray, ms: float = 10.0) -> JobRecord:
    # sigma 0.1 in every direction, so that an error of 0.1 m alone has a NEES of 1
    covariance = np.eye(6) * 0.01
    return job(LoopClosure(f"{ms:032.0f}", query, cand, T, covariance, 120, 300, ms))


def rejection(stage: str, ms: float = 2.0) -> JobRecord:
    return job(Rejection("1" * 32, kf("b", 1), kf("a", 0), stage, 3, 30, "pair 0", ms))


def snapshot(agents: str, T_map_body: dict[str, list[np.ndarray]]) -> MapSnapshot:
    """Three keyframes an agent, one second apart; odometry is right but for a frame of its own."""
    ids = [kf(agent, seq) for agent in agents for seq in range(3)]
    summary = MapSummary(
        SESSIONS[agents[0]], 1, tuple(SegmentId(a, SESSIONS[a]) for a in agents), len(ids), 0
    )
    truth = [pose(float(found.seq)) for found in ids]
    return MapSnapshot(
        summary=summary,
        keyframes=tuple(ids),
        stamps_ns=np.array([found.seq * SECOND for found in ids]),
        T_map_body=np.stack([T for agent in agents for T in T_map_body[agent]]),
        T_odom_body=pose(5.0, 5.0, 1.0) @ np.stack(truth),
        edge_from=np.array([0]),
        edge_to=np.array([1]),
        T_from_to=pose(1.0)[None],
        information=np.eye(6)[None],
        is_loop=np.array([True]),
    )


TRUTH = Trajectory(np.arange(3) * SECOND, np.stack([pose(float(x)) for x in range(3)]))
PLAYED = {
    agent: {"session": SESSIONS[agent], "keyframes": 3, "bytes": 6000, "duration_s": 2.0}
    for agent in "ab"
}


def record(
    jobs: list[JobRecord], b_offset_m: float = 0.0, played: dict[str, Any] | None = None
) -> RunRecord:
    poses = {
        "a": [pose(float(x)) for x in range(3)],
        "b": [pose(float(x), b_offset_m) for x in range(3)],
    }
    truths = {"a": TRUTH, "b": TRUTH}
    return RunRecord([snapshot("ab", poses)], jobs, played or PLAYED, truths, 7.0)


def test_a_map_with_two_agents_apart_has_half_their_distance_as_joint_error() -> None:
    made = report.build(record([], b_offset_m=0.2))
    assert made["joint_ate_before_m"] == pytest.approx(0.0, abs=1e-4)
    # One alignment puts both 0.1 m beside the truth; each alone is perfect.
    assert made["joint_ate_after_m"] == pytest.approx(0.1, abs=1e-4)
    assert made["joint_ate_after_separate_m"] == pytest.approx(0.0, abs=1e-4)
    assert made["maps"] == [["a", "b"]]
    assert made["agents"]["b"]["ate_after_m"] == pytest.approx(0.0, abs=1e-4)


def test_loops_are_counted_and_measured_against_the_truth() -> None:
    # True T_cand_query of (b, 2) in (a, 0): two metres ahead.
    good = loop(kf("b", 2), kf("a", 0), pose(2.1), ms=20.0)
    wrong = loop(kf("a", 2), kf("a", 0), pose(2.0, 0.0, np.deg2rad(9.0)), ms=40.0)
    made = report.build(record([good, wrong, rejection("matches"), rejection("matches")]))
    loops = made["loops"]
    assert (loops["candidates"], loops["accepted"], loops["intra"], loops["inter"]) == (4, 2, 1, 1)
    assert loops["inter_pairs"] == {"a-b": 1}
    assert loops["rejected"] == {"matches": 2}
    assert loops["wrong"] == 1
    assert loops["t_err_median_m"] == pytest.approx(0.05, abs=1e-3)
    assert loops["r_err_median_deg"] == pytest.approx(4.5, abs=1e-2)
    assert loops["nees_mean"] == pytest.approx((1.0 + np.deg2rad(9.0) ** 2 / 0.01) / 2, abs=0.01)
    assert made["solver_ms"] == {"median": 11.0, "p95": pytest.approx(37.0)}


def test_keyframes_that_were_sent_but_are_in_no_map_are_lost() -> None:
    played = {**PLAYED, "b": {**PLAYED["b"], "keyframes": 5}}
    made = report.build(record([], played=played))
    assert made["keyframes_lost"] == 2
    assert made["kB_per_s_per_agent"] == pytest.approx(3.0)


def test_without_groundtruth_the_errors_are_absent_and_the_rest_is_there() -> None:
    full = record([loop(kf("b", 2), kf("a", 0), pose(2.0))])
    blind = RunRecord(full.snapshots, full.jobs, full.played, {}, 7.0)
    made = report.build(blind)
    assert made["joint_ate_after_m"] is None
    assert made["loops"]["accepted"] == 1
    assert made["loops"]["wrong"] is None


def test_paths_are_as_long_as_the_odometry_between_keyframes() -> None:
    made = report.build(record([]))
    assert {name: agent["path_m"] for name, agent in made["agents"].items()} == {"a": 2.0, "b": 2.0}
    assert made["scenario"] == "run"


def test_the_worst_loop_is_named_and_a_followed_one_bends_the_map() -> None:
    """The snapshot's one loop edge says 1 m from (a, 0) to (a, 1), which the map believes."""
    poses = {"a": [pose(0.0), pose(1.0), pose(2.0)], "b": [pose(0.0), pose(1.0), pose(2.0)]}
    # Truth: a's first keyframe is another 0.5 m back.
    truth = {
        "a": Trajectory(np.arange(3) * SECOND, np.stack([pose(-0.5), pose(1.0), pose(2.0)])),
        "b": TRUTH,
    }
    jobs = [loop(kf("a", 1), kf("a", 0), pose(1.0)), loop(kf("b", 2), kf("a", 2), pose(0.0))]
    made = report.build(RunRecord([snapshot("ab", poses)], jobs, PLAYED, truth, 7.0))
    loops = made["loops"]
    assert (loops["wrong"], loops["wrong_effective"], loops["wrong_bending"]) == (1, 1, 1)
    assert loops["t_err_max_m"] == pytest.approx(0.5)
    assert loops["r_err_max_deg"] == pytest.approx(0.0, abs=1e-3)


def test_a_wrong_loop_that_the_map_does_not_follow_is_silenced() -> None:
    # The edge's information is the identity: 1 m off is one sigma, 10 m are ten.
    poses = {"a": [pose(0.0), pose(11.0), pose(12.0)], "b": [pose(0.0), pose(1.0), pose(2.0)]}
    truth = {
        "a": Trajectory(np.arange(3) * SECOND, np.stack([pose(0.0), pose(11.0), pose(12.0)])),
        "b": TRUTH,
    }
    jobs = [loop(kf("a", 1), kf("a", 0), pose(1.0))]
    loops = report.build(RunRecord([snapshot("ab", poses)], jobs, PLAYED, truth, 7.0))["loops"]
    assert (loops["wrong"], loops["wrong_effective"], loops["wrong_bending"]) == (1, 0, 0)
