"""Claim: on real images the fast profile finds several times the paper's loops, and rightly.

Set-up of the loop research: agents are frames 0-399, 300-699 and 600-999 of redkitchen with its
drifting odometry; keyframes at 0.15 m or 0.15 rad; jobs are all pairs of different agents that are
near by ground truth (0.7 m, 40 degrees, more than 2 s apart). Both profiles solve the same jobs.
Wrong is off by more than 0.5 m or 10 degrees. The ground truth is good to 4 cm and 1.2 degrees a
pair, which is added to the covariance before NEES. Odometry has the default noise of the
configuration. Nothing in the solver was fitted to this recording.

    python -m benchmarks.loop_accuracy [--data FOLDER] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import covinz_core as core
import numpy as np
from covinz_agents.selection import select_keyframes
from covinz_agents.tum import TumRecording
from numpy.typing import NDArray

from benchmarks.loop_geometry import Agent, View
from covinz import frames
from covinz.config import KeyframeSelectionConfig, LoopSolverConfig, OdometryNoise
from covinz.evaluation import nees, relative_errors, true_loops
from covinz.scenario import TumAgent, load_scenario
from services.loop_solver.solver import loop_options

Array = NDArray[np.float64]

_REPOSITORY = Path(__file__).resolve().parents[1]
_DATA = Path(os.environ.get("COVINZ_DATA", _REPOSITORY.parent / "shared" / "data"))
_FRAMES = ((0, 399), (300, 699), (600, 999))
_MAX_GAP_NS = 100_000_000
_NEAR_M = 0.7
_NEAR_RAD = np.deg2rad(40)
_APART_NS = 2_000_000_000
_WRONG_M = 0.5
_WRONG_RAD = np.deg2rad(10)
# Of the ground truth of a pair, in all; a third of the variance an axis.
_TRUTH_RAD = np.deg2rad(1.2)
_TRUTH_M = 0.04
_TRUTH_COVARIANCE = np.diag(np.repeat([_TRUTH_RAD**2 / 3, _TRUTH_M**2 / 3], 3))
# Keyframes of a rig relative to its reference, and the motions between them (positions).
_QUERY_RIG, _QUERY_MOTIONS = (0, -1), ((1, 0),)
_CAND_RIG, _CAND_MOTIONS = (0, -1, 1), ((1, 0), (0, 2))


def read_agent(agent: TumAgent) -> tuple[Agent, list[int]]:
    """Keyframes of one agent, and their stamps [ns]."""
    recording = TumRecording(agent)
    camera, truth = recording.camera, recording.groundtruth
    views, stamps = [], []
    for frame in select_keyframes(recording.frames, agent.keyframes):
        T_world_body = truth.at(frame.stamp_ns, _MAX_GAP_NS) if truth else None
        if T_world_body is None:
            continue
        features = recording.features(frame)
        bearings = core.bearing_vectors(
            camera.model, camera.params.tolist(), features.keypoints_px.astype(np.float64)
        )
        views.append(View(frame.T_odom_body, T_world_body, bearings, features.descriptors))
        stamps.append(frame.stamp_ns)
    return Agent(views, camera.T_body_cam, float(np.mean(camera.params[:2]))), stamps


def jobs(
    agents: Sequence[tuple[Agent, list[int]]],
) -> Iterator[tuple[Agent, int, Agent, int]]:
    """Query and candidate keyframes of different agents that see one place."""
    for number, (query, query_stamps) in enumerate(agents):
        for cand, cand_stamps in agents[:number]:
            for q, view in enumerate(query.views):
                for c, other in enumerate(cand.views):
                    T = frames.inverse(other.T_world_body) @ view.T_world_body
                    near = np.linalg.norm(T[:3, 3]) < _NEAR_M and (
                        frames.rotation_angle(T) < _NEAR_RAD
                    )
                    if near and abs(query_stamps[q] - cand_stamps[c]) > _APART_NS:
                        yield query, q, cand, c


def motion(agent: Agent, reference: int, offsets: tuple[int, int]) -> Array:
    """(6, 6) covariance of the camera's motion between two keyframes, a random walk."""
    noise = OdometryNoise()
    T_a, T_b = (agent.views[reference + offset].T_odom_body for offset in offsets)
    T = frames.inverse(T_a) @ T_b
    metres, radians = np.linalg.norm(T[:3, 3]), frames.rotation_angle(T)
    rotation = noise.rotation_per_sqrt_m**2 * metres + noise.rotation_per_sqrt_rad**2 * radians
    translation = (
        noise.translation_per_sqrt_m**2 * metres + noise.translation_per_sqrt_rad**2 * radians
    )
    covariance = np.diag(
        np.repeat([rotation + noise.min_rotation**2, translation + noise.min_translation**2], 3)
    )
    to_camera = frames.adjoint(frames.inverse(agent.T_body_cam))
    moved: Array = to_camera @ covariance @ to_camera.T
    return (moved + moved.T) / 2


def rig(
    agent: Agent,
    reference: int,
    offsets: Sequence[int],
    motions: Sequence[tuple[int, int]],
) -> core.LoopRig | None:
    """The rig with its odometry; None at the ends of the run."""
    cameras = agent.rig(reference, offsets)
    if cameras is None:
        return None
    return core.LoopRig(
        cameras,
        [
            core.RigMotion(a, b, motion(agent, reference, (offsets[a], offsets[b])))
            for a, b in motions
        ],
    )


def solve(
    method: str, query: tuple[Agent, int], cand: tuple[Agent, int], seed: int
) -> core.LoopEstimate | core.LoopRejection | None:
    """One job by one method; None where a rig lacks a keyframe."""
    if method == "paper":
        query_cameras, cand_cameras = (
            query[0].rig(query[1], _QUERY_RIG),
            cand[0].rig(cand[1], _CAND_RIG),
        )
        if query_cameras is None or cand_cameras is None:
            return None
        return core.solve_loop(query_cameras, cand_cameras, loop_options(LoopSolverConfig(), seed))
    query_rig = rig(*query, _QUERY_RIG, _QUERY_MOTIONS)
    cand_rig = rig(*cand, _CAND_RIG, _CAND_MOTIONS)
    if query_rig is None or cand_rig is None:
        return None
    options = core.FastLoopOptions()
    options.seed = seed
    return core.solve_loop_fast(query_rig, cand_rig, options)


def summary(
    truth: Sequence[Array], loops: Sequence[core.LoopEstimate], times_ms: Sequence[float]
) -> dict[str, Any]:
    """The figures of the claim for one method."""
    T_true, T_estimate = np.array(truth), np.array([loop.T_cand_query for loop in loops])
    errors = relative_errors(T_true, T_estimate)
    wrong = (errors.translation_m > _WRONG_M) | (errors.rotation_rad > _WRONG_RAD)
    covariance = np.array([loop.covariance for loop in loops])
    values = nees(T_true, T_estimate, covariance + _TRUTH_COVARIANCE)
    return {
        "jobs": len(times_ms),
        "accepted": len(loops),
        "wrong": int(wrong.sum()),
        "t_err_median_m": float(np.median(errors.translation_m)),
        "r_err_median_deg": float(np.rad2deg(np.median(errors.rotation_rad))),
        "nees_mean": float(values.mean()),
        "nees_median": float(np.median(values)),
        "nees_mean_without_truth": float(nees(T_true, T_estimate, covariance).mean()),
        "ms_median": float(np.median(times_ms)),
    }


def measure(folder: Path, methods: Sequence[str]) -> dict[str, Any]:
    """Every job by every method."""
    scenario = load_scenario(
        _REPOSITORY / "scenarios" / "redkitchen.yaml", {"COVINZ_DATA": str(folder)}
    )
    base = next(agent for agent in scenario.agents if isinstance(agent, TumAgent))
    keyframes = KeyframeSelectionConfig(translation_m=0.15, rotation_rad=0.15)
    agents = [
        read_agent(base.model_copy(update={"frames": part, "keyframes": keyframes}))
        for part in _FRAMES
    ]
    results: dict[str, Any] = {}
    for method in methods:
        rejected: Counter[str] = Counter()
        truth, loops, times_ms = [], [], []
        for seed, (query, q, cand, c) in enumerate(jobs(agents)):
            begin = time.thread_time()
            result = solve(method, (query, q), (cand, c), seed)
            if result is None:
                continue
            times_ms.append(1e3 * (time.thread_time() - begin))
            if isinstance(result, core.LoopRejection):
                rejected[result.stage] += 1
                continue
            truth.append(true_loops(cand.views[c].T_world_body, query.views[q].T_world_body))
            loops.append(result)
        results[method] = summary(truth, loops, times_ms) | {"rejected": dict(rejected)}
    return {"benchmark": "loop_accuracy", "redkitchen": results}


def main() -> int:
    """Measure, print and write JSON; without the recording, say so and do nothing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=_DATA, help="folder that holds redkitchen/")
    parser.add_argument("--methods", nargs="+", default=["paper", "fast"])
    parser.add_argument("--json", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    if not (arguments.data / "redkitchen").is_dir():
        sys.stderr.write(f"skipped: needs {arguments.data / 'redkitchen'}\n")
        return 0
    report = json.dumps(measure(arguments.data, arguments.methods), indent=2) + "\n"
    sys.stdout.write(report)
    if arguments.json:
        arguments.json.write_text(report)
    return 0


if __name__ == "__main__":
    sys.exit(main())
