"""Claim: a worker's memory stays flat over ten thousand jobs.

One LoopSolver solves generated problems of several kinds over and over, every time as a job of its
own with its own seed. The resident memory is read after a tenth of the jobs, when every problem was
solved many times, and at the end.

    python -m benchmarks.worker_memory [--jobs N] [--json FILE]
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
import os
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.loop_conditions import CONDITIONS
from benchmarks.loop_problems import (
    FOCAL_PX,
    IMAGE_SIZE_PX,
    T_BODY_CAM,
    Array,
    View,
    generate,
)
from covinz import frames
from covinz.config import LoopSolverConfig
from covinz.types import (
    Camera,
    Features,
    FeatureType,
    Keyframe,
    KeyframeId,
    LoopJob,
    Rejection,
    RigMember,
)
from services.loop_solver.solver import LoopSolver

_SEEDS = 6
_CENTRE_PX = (np.array(IMAGE_SIZE_PX) - 1) / 2
_CAMERA = Camera(
    model="PINHOLE",
    width=IMAGE_SIZE_PX[0],
    height=IMAGE_SIZE_PX[1],
    params=np.array([FOCAL_PX, FOCAL_PX, *_CENTRE_PX]),
    T_body_cam=T_BODY_CAM,
)
_MIB = 1 << 20


@dataclass(slots=True)
class Keyframes:
    """All keyframes at hand, so that what grows is the solver."""

    keyframes: dict[KeyframeId, Keyframe] = field(default_factory=dict)

    def keyframe(self, keyframe_id: KeyframeId) -> Keyframe:
        """The one asked for."""
        return self.keyframes[keyframe_id]

    def camera(self, camera_hash: str) -> Camera:
        """The one camera that there is."""
        del camera_hash
        return _CAMERA


def add_rig(
    store: Keyframes, agent: str, session: str, views: Sequence[View], T_rig_cam: Array
) -> tuple[RigMember, ...]:
    """The keyframes of a rig, posed in the body frame of the first one."""
    members = []
    # A rig is its reference, the keyframe before it and the one after it.
    for view, T, seq in zip(views, T_rig_cam, (1, 0, 2), strict=False):
        keypoints_px = FOCAL_PX * view.bearings[:, :2] / view.bearings[:, 2:] + _CENTRE_PX
        keyframe = Keyframe(
            id=KeyframeId(agent, session, seq),
            stamp_ns=seq,
            T_odom_body=T @ frames.inverse(T_BODY_CAM),
            camera_hash=_CAMERA.hash,
            features=Features(FeatureType.ORB, keypoints_px.astype(np.float32), view.descriptors),
        )
        store.keyframes[keyframe.id] = keyframe
        members.append(RigMember(keyframe.id, keyframe.T_odom_body, _CAMERA.hash))
    return tuple(members)


def problems(store: Keyframes) -> list[tuple[tuple[RigMember, ...], tuple[RigMember, ...]]]:
    """Both rigs of each problem."""
    rigs: list[tuple[tuple[RigMember, ...], tuple[RigMember, ...]]] = []
    for condition in CONDITIONS.values():
        for seed in range(_SEEDS):
            problem = generate(condition, seed)
            session = f"{len(rigs):026d}"
            rigs.append(
                (
                    add_rig(store, "a", session, problem.query_views, problem.T_query_cam_odometry),
                    add_rig(store, "b", session, problem.cand_views, problem.T_cand_cam_odometry),
                )
            )
    return rigs


def resident_mib() -> float:
    """Resident memory of this process."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / _MIB


def measure(num_jobs: int) -> dict[str, Any]:
    """Memory after a tenth of the jobs and after all of them."""
    store = Keyframes()
    rigs = problems(store)
    solver = LoopSolver(LoopSolverConfig(), store)
    outcomes: Counter[str] = Counter()
    resident = {}
    for number in range(1, num_jobs + 1):
        query, cand = rigs[number % len(rigs)]
        job = hashlib.blake2b(number.to_bytes(8), digest_size=16).hexdigest()
        outcome = solver.solve(LoopJob(job, query, cand, 0.0))
        outcomes[outcome.stage if isinstance(outcome, Rejection) else "accepted"] += 1
        if number in (num_jobs // 10, num_jobs):
            resident[number] = resident_mib()
    first, last = resident.values()
    return {
        "benchmark": "worker_memory",
        "problems": len(rigs),
        "jobs": num_jobs,
        "outcomes": dict(outcomes),
        "resident_mib": {str(number): value for number, value in resident.items()},
        "growth_mib": last - first,
    }


def main() -> None:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--jobs", type=int, default=10_000)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    report = json.dumps(measure(arguments.jobs), indent=2) + "\n"
    sys.stdout.write(report)
    if arguments.json:
        arguments.json.write_text(report)


if __name__ == "__main__":
    main()
