"""The paper's own comparison: the query camera's pose from points that odometry triangulates.

The candidate image's keypoints are matched to its neighbours in the rig and triangulated with the
rig as odometry has it; what of them the query image shows gives its pose by PnP. That is what a
server can do that receives no map points: COVINS itself is sent those of the front-end's map, which
more images have seen, so its own figures in the paper are not these.

Iterations, confidence and least numbers are the public COVINS code's; matches are those of profile
`fast`, in number and in time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import covinz_core as core
import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.loop_figures import NoPose, Pose, Result
from covinz import frames
from covinz.config import LoopSolverConfig
from covinz.keyframes import KeyframeStore
from covinz.types import FeatureType, LoopJob, RigMember
from services.loop_solver.kinds import shared_kind
from services.loop_solver.rig import BadRig
from services.loop_solver.solver import fast_loop_options

Array = NDArray[np.float64]

_MIN_MATCHES = 40
_MIN_INLIERS = 20
_ITERATIONS = 300
_CONFIDENCE = 0.99
# Less than this between the rays to a point, and odometry's error decides on its depth.
_MIN_PARALLAX_RAD = np.deg2rad(1)


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """A keyframe of a rig: its camera's pose in the body frame of the reference, and features."""

    T_rig_cam: Array
    T_body_cam: Array
    bearings: Array
    descriptors: NDArray[np.uint8]
    focal_px: float


def read_images(
    members: Sequence[RigMember], store: KeyframeStore, kind: FeatureType
) -> list[Image]:
    """The images of a rig, the reference first; raises as `services.loop_solver.rig.build_rig`."""
    T_rig_odom = frames.inverse(members[0].T_odom_body)
    images = []
    for member in members:
        features = store.keyframe(member.keyframe).features_of(kind)
        if features is None:
            raise BadRig(f"keyframe {member.keyframe} has no {kind.name} features")
        camera = store.camera(member.camera_hash)
        bearings = core.bearing_vectors(
            camera.model, camera.params.tolist(), features.keypoints_px.astype(np.float64)
        )
        seen = np.isfinite(bearings).all(1) & (bearings[:, 2] > 0)
        images.append(
            Image(
                T_rig_odom @ member.T_odom_body @ camera.T_body_cam,
                camera.T_body_cam,
                bearings[seen],
                features.descriptors[seen],
                float(np.mean(camera.params[:2])),
            )
        )
    return images


def prepared(job: LoopJob, config: LoopSolverConfig, store: KeyframeStore) -> Callable[[], Result]:
    """The baseline for one job, everything read and ready to be called."""
    kind = shared_kind(job, store, config.kinds)
    query = read_images(job.query_rig[:1], store, kind)[0]
    cand = read_images(job.cand_rig, store, kind)
    matching = fast_loop_options(config, job.seed, kind).matching
    return lambda: solve_pnp(query, cand, matching, config.fast.max_error_px)


def solve_pnp(
    query: Image, cand: Sequence[Image], options: core.MatchingOptions, max_error_px: float
) -> Result:
    """Pose of the query body in the candidate's, by the candidate's points in the query image."""
    packed = [core.PackedDescriptors(image.descriptors) for image in cand]
    points = np.full((len(cand[0].bearings), 3), np.nan)
    parallax_rad = np.full(len(points), _MIN_PARALLAX_RAD)
    for image, descriptors in zip(cand[1:], packed[1:], strict=True):
        rows = core.match_packed(packed[0], descriptors, options)
        found, angle_rad = triangulate(cand[0], image, rows, max_error_px)
        better = np.isfinite(found[:, 0]) & (angle_rad > parallax_rad[rows[:, 0]])
        points[rows[better, 0]] = found[better]
        parallax_rad[rows[better, 0]] = angle_rad[better]
    rows = core.match_packed(core.PackedDescriptors(query.descriptors), packed[0], options)
    rows = rows[np.isfinite(points[rows[:, 1], 0])]
    if len(rows) < _MIN_MATCHES:
        return NoPose("matches")
    return _pose(query, points[rows[:, 1]], query.bearings[rows[:, 0]], max_error_px)


def triangulate(
    first: Image, second: Image, rows: NDArray[np.integer[Any]], max_error_px: float
) -> tuple[Array, Array]:
    """Mid-points (M, 3) in the rig's frame, and the angles (M,) between their rays [rad].

    NaN for a point behind a camera or further from a ray than its keypoint may be wrong.
    """
    rays = [
        image.bearings[rows[:, side]] @ image.T_rig_cam[:3, :3].T
        for side, image in enumerate((first, second))
    ]
    between = second.T_rig_cam[:3, 3] - first.T_rig_cam[:3, 3]
    cosine = (rays[0] * rays[1]).sum(1)
    along = [ray @ between for ray in rays]
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    depths = ((along[0] - cosine * along[1]) / sine2, (cosine * along[0] - along[1]) / sine2)
    ends = [
        image.T_rig_cam[:3, 3] + depth[:, None] * ray
        for image, depth, ray in zip((first, second), depths, rays, strict=True)
    ]
    points: Array = (ends[0] + ends[1]) / 2
    apart_m = np.linalg.norm(ends[0] - ends[1], axis=1) / 2
    good = np.ones(len(rows), dtype=bool)
    for image, depth in zip((first, second), depths, strict=True):
        good &= (depth > 0) & (image.focal_px * apart_m < max_error_px * depth)
    points[~good] = np.nan
    return points, np.arccos(np.clip(cosine, -1, 1))


def _pose(query: Image, points: Array, bearings: Array, max_error_px: float) -> Result:
    pixels = query.focal_px * bearings[:, :2] / bearings[:, 2:]
    camera = np.diag([query.focal_px, query.focal_px, 1.0])
    found, turn, shift, inliers = cv2.solvePnPRansac(
        points, pixels, camera, None, iterationsCount=_ITERATIONS, confidence=_CONFIDENCE,
        reprojectionError=max_error_px, flags=cv2.SOLVEPNP_AP3P,
    )  # fmt: skip
    if not found or inliers is None or len(inliers) < _MIN_INLIERS:
        return NoPose("rig_inliers")
    kept = inliers[:, 0]
    turn, shift = cv2.solvePnPRefineLM(points[kept], pixels[kept], camera, None, turn, shift)
    T_cam_cand = frames.transform(cv2.Rodrigues(turn)[0], shift[:, 0])
    T_cand_cam = frames.inverse(T_cam_cand)
    return Pose(T_cand_cam @ frames.inverse(query.T_body_cam))
