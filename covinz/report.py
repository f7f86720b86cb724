"""What a run is worth: the figures of report.json, from the server's answers and ground truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covinz import client, evaluation, export, frames, picture
from covinz.bus import Bus
from covinz.evaluation import PosePairs
from covinz.scenario import Scenario, groundtruth
from covinz.trajectory import Trajectory
from covinz.types import Array, JobRecord, KeyframeId, LoopClosure, MapSnapshot, Rejection

# A loop is wrong when it is off by more than either.
WRONG_M = 0.3
WRONG_RAD = float(np.deg2rad(8.0))


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """What was left to evaluate when the server became idle.

    Attributes:
        snapshots: Every map, oldest first.
        jobs: Every job with its outcome.
        played: The player's summary: per agent session, keyframes, bytes, duration_s.
        groundtruth: True body poses by agent, for those that have any.
        server_s: From the first keyframe until the server was idle.
    """

    snapshots: Sequence[MapSnapshot]
    jobs: Sequence[JobRecord]
    played: Mapping[str, Any]
    groundtruth: Mapping[str, Trajectory]
    server_s: float


def collect(
    bus: Bus, scenario: Scenario, played: Mapping[str, Any], folder: Path, server_s: float
) -> RunRecord:
    """Ask an idle server for everything that a report needs."""
    truths = {agent.id: groundtruth(scenario, agent.id, folder) for agent in scenario.agents}
    return RunRecord(
        client.snapshots(bus),
        list(client.jobs(bus)),
        played,
        {agent: truth for agent, truth in truths.items() if truth is not None},
        server_s,
    )


def build(record: RunRecord) -> dict[str, Any]:
    """The report as JSON-ready values; a figure without ground truth is None."""
    before = _pairs(record, export.trajectories(record.snapshots, odometry=True))
    after = _pairs(record, export.trajectories(record.snapshots))
    in_maps = Counter(kf.agent for snapshot in record.snapshots for kf in snapshot.keyframes)
    sent = {agent: int(item["keyframes"]) for agent, item in record.played.items()}
    rates = {
        agent: item["bytes"] / 1000 / item["duration_s"] if item["duration_s"] > 0 else 0.0
        for agent, item in record.played.items()
    }
    return {
        "agents": {
            agent: {
                "keyframes": sent[agent],
                "bytes": int(item["bytes"]),
                "kB_per_s": round(rates[agent], 1),
                "ate_before_m": _ate(before, agent),
                "ate_after_m": _ate(after, agent),
            }
            for agent, item in sorted(record.played.items())
        },
        "maps": [
            sorted({segment.agent for segment in snapshot.summary.segments})
            for snapshot in record.snapshots
        ],
        "joint_ate_before_m": _rounded(evaluation.separate_ate_m, list(before.values())),
        "joint_ate_after_m": _joint_after(record),
        "joint_ate_after_separate_m": _rounded(evaluation.separate_ate_m, list(after.values())),
        "loops": loop_figures(record),
        "solver_ms": _solver_ms(record.jobs),
        "keyframes_lost": sum(max(0, sent[agent] - in_maps[agent]) for agent in sent),
        "kB_per_s_per_agent": round(float(np.mean(list(rates.values()))), 1) if rates else 0.0,
        "server_s": round(record.server_s, 3),
    }


def loop_figures(record: RunRecord) -> dict[str, Any]:
    """Counts of candidates, loops and rejections, and the loops' errors against ground truth."""
    outcomes = [job.outcome for job in record.jobs]
    loops = [outcome for outcome in outcomes if isinstance(outcome, LoopClosure)]
    stages = Counter(outcome.stage for outcome in outcomes if isinstance(outcome, Rejection))
    pairs = Counter("-".join(sorted((loop.query.agent, loop.cand.agent))) for loop in loops)
    intra = sum(loop.query.agent == loop.cand.agent for loop in loops)
    return {
        "candidates": len(record.jobs),
        "accepted": len(loops),
        "intra": intra,
        "inter": len(loops) - intra,
        "inter_pairs": {
            pair: count for pair, count in sorted(pairs.items()) if len(set(pair.split("-"))) > 1
        },
        "rejected": dict(sorted(stages.items())),
        **_loop_errors(record, loops),
    }


def _loop_errors(record: RunRecord, loops: Sequence[LoopClosure]) -> dict[str, Any]:
    truth = _true_poses(record)
    known = [loop for loop in loops if loop.query in truth and loop.cand in truth]
    empty = ("wrong", "t_err_median_m", "r_err_median_deg", "nees_mean", "nees_median")
    if not known:
        return {"with_groundtruth": 0, **dict.fromkeys(empty)}
    T_est = np.stack([loop.T_cand_query for loop in known])
    T_true = evaluation.true_loops(
        np.stack([truth[loop.cand] for loop in known]),
        np.stack([truth[loop.query] for loop in known]),
    )
    errors = evaluation.relative_errors(T_true, T_est)
    wrong = (errors.translation_m > WRONG_M) | (errors.rotation_rad > WRONG_RAD)
    nees = evaluation.nees(T_true, T_est, np.stack([loop.covariance for loop in known]))
    figures = (
        int(wrong.sum()),
        round(float(np.median(errors.translation_m)), 4),
        round(float(np.rad2deg(np.median(errors.rotation_rad))), 3),
        round(float(nees.mean()), 2),
        round(float(np.median(nees)), 2),
    )
    return {"with_groundtruth": len(known), **dict(zip(empty, figures, strict=True))}


def _true_poses(record: RunRecord) -> dict[KeyframeId, Array]:
    """True T_world_body of every keyframe that has ground truth."""
    poses = {}
    for snapshot in record.snapshots:
        for keyframe, stamp in zip(snapshot.keyframes, snapshot.stamps_ns, strict=True):
            truth = record.groundtruth.get(keyframe.agent)
            T = truth.at(int(stamp), evaluation.MAX_GAP_NS) if truth is not None else None
            if T is not None:
                poses[keyframe] = T
    return poses


def _pairs(record: RunRecord, found: Mapping[str, Trajectory]) -> dict[str, PosePairs]:
    paired = {
        agent: evaluation.associate(path, record.groundtruth[agent])
        for agent, path in found.items()
        if agent in record.groundtruth
    }
    return {agent: pairs for agent, pairs in paired.items() if len(pairs)}


def _joint_after(record: RunRecord) -> float | None:
    """ATE with one alignment for each map, errors pooled; for one map the paper's metric."""
    errors = []
    for snapshot in record.snapshots:
        pairs = list(_pairs(record, export.trajectories([snapshot])).values())
        if pairs:
            T_ref_map = evaluation.alignment(pairs)
            errors += [evaluation.position_errors(pair, T_ref_map) for pair in pairs]
    return round(evaluation.rmse(np.concatenate(errors)), 4) if errors else None


def _ate(pairs: Mapping[str, PosePairs], agent: str) -> float | None:
    return round(evaluation.ate_m(pairs[agent]), 4) if agent in pairs else None


def _rounded(figure: Any, pairs: Sequence[PosePairs]) -> float | None:
    return round(figure(pairs), 4) if pairs else None


def _solver_ms(jobs: Sequence[JobRecord]) -> dict[str, float | None]:
    times = [job.outcome.solver_ms for job in jobs if job.outcome is not None]
    if not times:
        return {"median": None, "p95": None}
    median, p95 = np.percentile(times, [50, 95])
    return {"median": round(float(median), 1), "p95": round(float(p95), 1)}


def draw(record: RunRecord, made: Mapping[str, Any], file: Path) -> None:
    """Draw the run: every odometry in its own frame, then every map with its loops."""
    drawings = [_drawing(record, snapshot) for snapshot in record.snapshots]
    drawings.sort(key=lambda drawing: -sum(map(len, drawing.paths.values())))
    before = _segment_paths(record.snapshots, odometry=True)
    loops = made["loops"]
    title = f"{loops['accepted']} loops, {loops['inter']} between robots"
    if made["joint_ate_after_m"] is not None:
        title += (
            f"; joint ATE {100 * made['joint_ate_before_m']:.1f} cm (each odometry aligned alone)"
            f" -> {100 * made['joint_ate_after_m']:.1f} cm (one alignment)"
        )
    if before:
        picture.draw_top_view(file, before, drawings, title)


def _drawing(record: RunRecord, snapshot: MapSnapshot) -> picture.MapDrawing:
    positions = snapshot.T_map_body[:, :3, 3]
    ends = np.stack([snapshot.edge_from, snapshot.edge_to], axis=-1)[snapshot.is_loop]
    truths = {}
    pairs = _pairs(record, export.trajectories([snapshot]))
    if pairs:
        T_map_ref = frames.inverse(evaluation.alignment(pairs.values()))
        truths = {a: (T_map_ref @ pair.T_ref_body)[:, :3, 3] for a, pair in pairs.items()}
    return picture.MapDrawing(_segment_paths([snapshot]), positions[ends], truths)


def _segment_paths(
    snapshots: Sequence[MapSnapshot], *, odometry: bool = False
) -> dict[str, list[NDArray[np.float64]]]:
    """(N, 3) positions of every segment in order of seq, by agent."""
    paths: dict[str, list[NDArray[np.float64]]] = {}
    for snapshot in snapshots:
        poses = snapshot.T_odom_body if odometry else snapshot.T_map_body
        for segment in snapshot.summary.segments:
            index = [i for i, kf in enumerate(snapshot.keyframes) if kf.segment == segment]
            index.sort(key=lambda i: snapshot.keyframes[i].seq)
            paths.setdefault(segment.agent, []).append(poses[index, :3, 3])
    return paths
