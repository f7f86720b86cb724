"""A loop job with everything that it takes to solve it again: one file, for one job.

A zip archive of messages as they travel: ``job.bin``, ``keyframe-N.bin``, ``camera-N.bin`` and the
solver's section of the configuration, ``loop_solver.json``.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from covinz import codec
from covinz.config import LoopSolverConfig
from covinz.keyframes import CameraNotFound, KeyframeNotFound, KeyframeStore
from covinz.types import Camera, Keyframe, KeyframeId, LoopJob

# Below the server's data.
FOLDER = "dead_jobs"


class SavedJobError(ValueError):
    """A file that holds no saved job; the message names it."""


@dataclass(frozen=True, slots=True, eq=False)
class SavedJob:
    """A `KeyframeStore` that has what one job needs.

    Attributes:
        job: The job.
        config: What the solver was configured with.
        keyframes: Those of both rigs.
        cameras: Theirs, by hash.
    """

    job: LoopJob
    config: LoopSolverConfig
    keyframes: Mapping[KeyframeId, Keyframe]
    cameras: Mapping[str, Camera]

    def keyframe(self, keyframe_id: KeyframeId) -> Keyframe:
        """See `KeyframeStore.keyframe`."""
        if keyframe_id not in self.keyframes:
            raise KeyframeNotFound(f"no keyframe {keyframe_id} was saved")
        return self.keyframes[keyframe_id]

    def camera(self, camera_hash: str) -> Camera:
        """See `KeyframeStore.camera`."""
        if camera_hash not in self.cameras:
            raise CameraNotFound(f"no camera {camera_hash} was saved")
        return self.cameras[camera_hash]


def saved_job_path(data: Path, job_id: str) -> Path:
    """Where the server keeps the input of a job that it gave up."""
    return data / FOLDER / f"{job_id}.zip"


def gather(job: LoopJob, config: LoopSolverConfig, store: KeyframeStore) -> SavedJob:
    """Fetch what a job needs.

    Raises:
        KeyframeNotFound, CameraNotFound, StoreUnavailable: From the store.
    """
    names = [member.keyframe for member in (*job.query_rig, *job.cand_rig)]
    keyframes = {name: store.keyframe(name) for name in names}
    hashes = sorted({kf.camera_hash for kf in keyframes.values()})
    return SavedJob(job, config, keyframes, {name: store.camera(name) for name in hashes})


def write_saved_job(path: Path, saved: SavedJob) -> None:
    """Write all or nothing; raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    with zipfile.ZipFile(unfinished, "w") as archive:
        archive.writestr("job.bin", codec.encode(saved.job))
        archive.writestr("loop_solver.json", saved.config.model_dump_json(indent=1))
        for number, keyframe in enumerate(saved.keyframes.values()):
            archive.writestr(f"keyframe-{number}.bin", codec.encode(keyframe))
        for number, camera in enumerate(saved.cameras.values()):
            archive.writestr(f"camera-{number}.bin", codec.encode(camera))
    os.replace(unfinished, path)


def read_saved_job(path: Path) -> SavedJob:
    """Read what `write_saved_job` wrote.

    Raises:
        SavedJobError: If the file cannot be read or is something else.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        keyframes = [codec.decode(p, Keyframe) for n, p in parts.items() if n.startswith("keyf")]
        cameras = [codec.decode(p, Camera) for n, p in parts.items() if n.startswith("camera")]
        return SavedJob(
            codec.decode(parts["job.bin"], LoopJob),
            LoopSolverConfig.model_validate_json(parts["loop_solver.json"]),
            {keyframe.id: keyframe for keyframe in keyframes},
            {camera.hash: camera for camera in cameras},
        )
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise SavedJobError(f"{path} is no saved job: {error}") from error
