"""What robots see in the simulation, and a solver that knows the truth.

Everything is small: a dozen features a keyframe, ten places on a ring. Pose and outcome of a job
are pure functions of the names in it, so that a replay of the log gives the same.
"""

from __future__ import annotations

import functools
import hashlib
import tempfile
from collections.abc import Callable
from pathlib import Path

import covinz_core
import numpy as np

from covinz.config import Config, LoopSolverConfig
from covinz.frames import Array, inverse, so3_exp, transform
from covinz.keyframes import CameraNotFound, KeyframeNotFound, KeyframeStore
from covinz.types import (
    Camera,
    Features,
    FeatureType,
    KeyframeContent,
    LoopClosure,
    LoopJob,
    Outcome,
    Rejection,
    RigMember,
)

NUM_PLACES = 10
NUM_FEATURES = 12
RADIUS_M = 5.0
# Of so many jobs one has no loop.
NO_LOOP_OF = 5
CAMERA = Camera(
    "PINHOLE",
    640,
    480,
    np.array([500.0, 500.0, 319.5, 239.5]),
    transform(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3)),
)


@functools.cache
def descriptors() -> np.ndarray:
    """(places, features, 32): what each place shows."""
    rng = np.random.default_rng(7)
    return rng.integers(0, 256, (NUM_PLACES, NUM_FEATURES, 32), dtype=np.uint8)


@functools.cache
def vocabulary_file() -> Path:
    """A small vocabulary of these places; removed with the process."""
    flat = descriptors().reshape(-1, 32)
    offsets = np.arange(0, len(flat) + 1, NUM_FEATURES, dtype=np.int64)
    vocabulary = covinz_core.Vocabulary.train(flat, offsets, branching=4, depth=3, seed=1)
    folder = tempfile.TemporaryDirectory(prefix="covinz-vocabulary-")
    _FOLDERS.append(folder)
    path = Path(folder.name) / "places.bin"
    path.write_bytes(vocabulary.to_bytes())
    return path


_FOLDERS: list[tempfile.TemporaryDirectory[str]] = []


def configuration(neighbours: str, max_spool_bytes: int | None) -> Config:
    """Defaults, but for the small vocabulary and guards that suit a dozen keyframes."""
    values: dict[str, object] = {
        "place_recognition": {
            "vocabulary": vocabulary_file(),
            "min_features": 4,
            "min_score": 0.1,
            "num_candidates": 2,
            "min_loop_keyframes": 4,
            "min_loop_s": 0.0,
            "rigs": {"neighbours": neighbours, "max_path_m": 8.0},
        },
        "loop_solver": {"kinds": ("orb",)},
    }
    if max_spool_bytes is not None:
        values["agent"] = {"max_spool_bytes": max_spool_bytes}
    return Config.model_validate(values)


def content(session: str, place: int, stamp_ns: int) -> KeyframeContent:
    """What a robot hands to its agent at a place, in the odometry frame of a session."""
    angle = 2 * np.pi * place / NUM_PLACES
    position = RADIUS_M * np.array([np.cos(angle), np.sin(angle), 0.0])
    T_world_body = transform(so3_exp(np.array([0.0, 0.0, angle])), position)
    px = np.random.default_rng(place).integers(16, 464, (NUM_FEATURES, 2)).astype(np.float32)
    return KeyframeContent(
        stamp_ns=stamp_ns,
        T_odom_body=inverse(T_world_odom(session)) @ T_world_body,
        camera=CAMERA,
        features=Features(FeatureType.ORB, px, descriptors()[place % NUM_PLACES]),
    )


def T_world_odom(session: str) -> Array:
    """Where a session's odometry began: anywhere, but always the same."""
    draw = np.frombuffer(hashlib.blake2b(session.encode(), digest_size=8).digest(), np.uint16)
    x, y, yaw, _ = draw / 65536
    return transform(so3_exp(np.array([0.0, 0.0, 6.0 * yaw])), [10.0 * x, 10.0 * y, 0.0])


def outcome(job: LoopJob) -> Outcome:
    """What the simulated solver says of a job."""
    draw = int(job.id[16:], 16)
    if draw % NO_LOOP_OF == 0:
        return Rejection(job.id, job.query, job.cand, "rig_inliers", 40.0, 100.0, "", 0.0)
    noise = np.frombuffer(bytes.fromhex(job.id[16:28]), np.uint8) / 255.0 - 0.5
    error = transform(so3_exp(0.01 * noise[:3]), 0.02 * noise[3:])
    return LoopClosure(
        job_id=job.id,
        query=job.query,
        cand=job.cand,
        T_cand_query=inverse(_pose(job.cand_rig[0])) @ _pose(job.query_rig[0]) @ error,
        covariance=np.diag([1e-4] * 3 + [4e-4] * 3),
        num_inliers=100 + draw % 50,
        num_matches=300,
        solver_ms=0.0,
    )


class TruthfulSolver:
    """`LoopSolver` with the truth in the place of the numeric core.

    Args:
        store: The real one: all keyframes and calibrations of the job are fetched.
        work: Called with each job once everything is there: takes time, or kills the process.
    """

    def __init__(
        self, _: LoopSolverConfig, store: KeyframeStore, work: Callable[[LoopJob], object]
    ) -> None:
        self._store = store
        self._work = work

    def solve(self, job: LoopJob) -> Outcome:
        """See `LoopSolver.solve`."""
        try:
            for member in (*job.query_rig, *job.cand_rig):
                keyframe = self._store.keyframe(member.keyframe)
                self._store.camera(keyframe.camera_hash)
        except KeyframeNotFound:
            return _missing(job, "keyframe_missing")
        except CameraNotFound:
            return _missing(job, "camera_missing")
        self._work(job)
        return outcome(job)


def _missing(job: LoopJob, stage: str) -> Rejection:
    """Of a log that was lost meanwhile."""
    return Rejection(job.id, job.query, job.cand, stage, 0.0, 0.0, "", 0.0)


def _pose(member: RigMember) -> Array:
    return T_world_odom(member.keyframe.session) @ member.T_odom_body
