"""What a run is worth: the figures of report.json, from the server's answers and ground truth."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from covinz import evaluation, export
from covinz.evaluation import PosePairs
from covinz.loop_edges import beyond_limits, loop_edges
from covinz.record import RunRecord
from covinz.trajectory import Trajectory
from covinz.types import JobRecord, LoopClosure, Rejection


def build(record: RunRecord) -> dict[str, Any]:
    """The report as JSON-ready values; a figure without ground truth is None.

    What needs more than its name:

    - ``agents.*.path_m``: length of the odometry between keyframes.
    - ``joint_ate_before_m``: every odometry aligned on its own; ``joint_ate_after_m``: one
      alignment for each map.
    - ``loops.wrong``: off the truth by more than `loop_edges.WRONG_M` or `WRONG_RAD`.
    - ``loops.wrong_effective``: wrong ones that the robust loss left more than half their weight
      in the optimised map (`loop_edges.robust_weights`).
    - ``loops.wrong_bending``: effective ones whose two ends are wrong in the map too, relative to
      each other and by the same limits: the loop got its way, the map is bent there.
    """
    before = _pairs(record, export.trajectories(record.snapshots, odometry=True))
    after = _pairs(record, export.trajectories(record.snapshots))
    in_maps = Counter(kf.agent for snapshot in record.snapshots for kf in snapshot.keyframes)
    sent = {agent: int(item["keyframes"]) for agent, item in record.played.items()}
    rates = {
        agent: item["bytes"] / 1000 / item["duration_s"] if item["duration_s"] > 0 else 0.0
        for agent, item in record.played.items()
    }
    paths_m = _path_lengths(record)
    return {
        "scenario": record.name,
        "agents": {
            agent: {
                "keyframes": sent[agent],
                "path_m": round(paths_m.get(agent, 0.0), 2),
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
    truth = record.true_poses()
    known = [loop for loop in loops if loop.query in truth and loop.cand in truth]
    empty = (
        *("wrong", "wrong_effective", "wrong_bending", "t_err_median_m", "r_err_median_deg"),
        *("t_err_max_m", "r_err_max_deg", "nees_mean", "nees_median"),
    )
    if not known:
        return {"with_groundtruth": 0, **dict.fromkeys(empty)}
    T_est = np.stack([loop.T_cand_query for loop in known])
    T_true = evaluation.true_loops(
        np.stack([truth[loop.cand] for loop in known]),
        np.stack([truth[loop.query] for loop in known]),
    )
    errors = evaluation.relative_errors(T_true, T_est)
    turned_deg = np.rad2deg(errors.rotation_rad)
    nees = evaluation.nees(T_true, T_est, np.stack([loop.covariance for loop in known]))
    edges = [loop_edges(found, truth, record.cauchy_scale) for found in record.snapshots]
    figures = (
        int(beyond_limits(errors).sum()),
        sum(int(found.effective.sum()) for found in edges),
        sum(int(found.bending.sum()) for found in edges),
        round(float(np.median(errors.translation_m)), 4),
        round(float(np.median(turned_deg)), 3),
        round(float(errors.translation_m.max()), 4),
        round(float(turned_deg.max()), 3),
        round(float(nees.mean()), 2),
        round(float(np.median(nees)), 2),
    )
    return {"with_groundtruth": len(known), **dict(zip(empty, figures, strict=True))}


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


def _path_lengths(record: RunRecord) -> dict[str, float]:
    """Metres of odometry from keyframe to keyframe, by agent."""
    lengths: dict[str, float] = defaultdict(float)
    for snapshot in record.snapshots:
        for segment in snapshot.summary.segments:
            index = [i for i, kf in enumerate(snapshot.keyframes) if kf.segment == segment]
            index.sort(key=lambda i: snapshot.keyframes[i].seq)
            steps = np.diff(snapshot.T_odom_body[index, :3, 3], axis=0)
            lengths[segment.agent] += float(np.linalg.norm(steps, axis=1).sum())
    return dict(lengths)


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
