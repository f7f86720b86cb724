"""Claim: the loops that the paper's geometry accepts on real images are right, and know how right.

Three agents are disjoint thirds of redkitchen with its drifting odometry. Every keyframe of an
agent asks for its three best candidates of each earlier agent, by matches that pass the ratio
test; their rigs are solved with the default configuration. Truth is only used to judge: wrong is
off by more than 0.3 m or 8 degrees. Times are CPU times of one thread.

    python -m benchmarks.loop_geometry [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import covinz_core as core
import numpy as np
from covinz_agents.selection import select_keyframes
from covinz_agents.tum import TumRecording
from numpy.typing import NDArray

from covinz import frames
from covinz.config import LoopSolverConfig
from covinz.evaluation import nees, relative_errors, true_loops
from covinz.scenario import TumAgent, load_scenario
from services.loop_solver.solver import loop_options

_REPOSITORY = Path(__file__).resolve().parents[1]
_DATA = Path(os.environ.get("COVINZ_DATA", _REPOSITORY.parent / "shared" / "data"))

_MAX_GAP_NS = 100_000_000
_CANDIDATES = 3
# Keyframes of a rig relative to its reference, as place recognition forms them.
_QUERY_RIG = (0, -1)
_CAND_RIG = (0, -1, 1)
_WRONG_M = 0.3
_WRONG_RAD = np.deg2rad(8)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A keyframe: its odometry and true pose and what the core needs of it."""

    T_odom_body: NDArray[np.float64]
    T_world_body: NDArray[np.float64]
    bearings: NDArray[np.float64]
    descriptors: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Agent:
    """Keyframes of one camera in order."""

    views: Sequence[View]
    T_body_cam: NDArray[np.float64]
    focal_px: float

    def rig(self, reference: int, offsets: Sequence[int]) -> list[core.RigCamera] | None:
        """The cameras around a keyframe; None at the ends of the run."""
        members = [reference + offset for offset in offsets]
        if min(members) < 0 or max(members) >= len(self.views):
            return None
        T_body_odom = frames.inverse(self.views[reference].T_odom_body)
        return [
            core.RigCamera(
                T_body_odom @ self.views[i].T_odom_body @ self.T_body_cam,
                self.views[i].bearings,
                self.views[i].descriptors,
                self.focal_px,
            )
            for i in members
        ]


def read_agent(agent: TumAgent) -> Agent:
    """Keyframes of one agent of the scenario."""
    recording = TumRecording(agent)
    camera, truth = recording.camera, recording.groundtruth
    views = []
    for frame in select_keyframes(recording.frames, agent.keyframes):
        T_world_body = truth.at(frame.stamp_ns, _MAX_GAP_NS) if truth else None
        if T_world_body is None:
            continue
        features = recording.features(frame)
        bearings = core.bearing_vectors(
            camera.model, camera.params.tolist(), features.keypoints_px.astype(np.float64)
        )
        views.append(View(frame.T_odom_body, T_world_body, bearings, features.descriptors))
    return Agent(views, camera.T_body_cam, float(np.mean(camera.params[:2])))


def num_alike(query: View, cand: View) -> int:
    """Matches that pass the ratio test, by Hamming distances of all pairs."""
    a, b = (np.unpackbits(v.descriptors, axis=1).astype(np.float32) for v in (query, cand))
    distances = a.sum(1)[:, None] + b.sum(1)[None] - 2 * a @ b.T
    best = np.partition(distances, 1, axis=1)[:, :2]
    return int((best[:, 0] < 0.8 * best[:, 1]).sum())


def candidates(agents: Sequence[Agent]) -> Iterator[tuple[Agent, int, Agent, int]]:
    """Queries with their best candidates."""
    for number, query in enumerate(agents):
        for cand in agents[:number]:
            for q, view in enumerate(query.views):
                scores = [num_alike(view, other) for other in cand.views]
                for c in np.argsort(scores, kind="stable")[::-1][:_CANDIDATES]:
                    yield query, q, cand, int(c)


def measure(folder: Path) -> dict[str, Any]:
    """All figures of the claim."""
    scenario = load_scenario(
        _REPOSITORY / "scenarios" / "redkitchen.yaml", {"COVINZ_DATA": str(folder)}
    )
    agents = [read_agent(a) for a in scenario.agents if isinstance(a, TumAgent)]
    rejected: Counter[str] = Counter()
    times_ms: dict[str, list[float]] = {"accepted": [], "rejected": []}
    T_true, T_estimate, covariances = [], [], []
    for seed, (query, q, cand, c) in enumerate(candidates(agents)):
        query_rig, cand_rig = query.rig(q, _QUERY_RIG), cand.rig(c, _CAND_RIG)
        if query_rig is None or cand_rig is None:
            continue
        begin = time.thread_time()
        result = core.solve_loop(query_rig, cand_rig, loop_options(LoopSolverConfig(), seed))
        accepted = isinstance(result, core.LoopEstimate)
        times_ms["accepted" if accepted else "rejected"].append(1e3 * (time.thread_time() - begin))
        if isinstance(result, core.LoopRejection):
            rejected[result.stage] += 1
            continue
        T_true.append(true_loops(cand.views[c].T_world_body, query.views[q].T_world_body))
        T_estimate.append(result.T_cand_query)
        covariances.append(result.covariance)
    errors = relative_errors(np.array(T_true), np.array(T_estimate))
    wrong = (errors.translation_m > _WRONG_M) | (errors.rotation_rad > _WRONG_RAD)
    nees_values = nees(np.array(T_true), np.array(T_estimate), np.array(covariances))
    return {
        "benchmark": "loop_geometry",
        "machine": platform.processor() or platform.machine(),
        "keyframes": [len(agent.views) for agent in agents],
        "accepted": len(T_true),
        "wrong": int(wrong.sum()),
        "rejected": dict(rejected),
        "t_err_median_m": float(np.median(errors.translation_m)),
        "r_err_median_deg": float(np.rad2deg(np.median(errors.rotation_rad))),
        "nees_mean": float(np.mean(nees_values)),
        "nees_median": float(np.median(nees_values)),
        "cpu_ms_median": {name: float(np.median(values)) for name, values in times_ms.items()},
    }


def main() -> int:
    """Measure, print and write JSON; without the recording, say so and do nothing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=_DATA, help="folder that holds redkitchen/")
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    if not (arguments.data / "redkitchen").is_dir():
        sys.stderr.write(f"skipped: needs {arguments.data / 'redkitchen'}\n")
        return 0
    report = json.dumps(measure(arguments.data), indent=2) + "\n"
    sys.stdout.write(report)
    if arguments.out:
        arguments.out.write_text(report)
    return 0


if __name__ == "__main__":
    sys.exit(main())
