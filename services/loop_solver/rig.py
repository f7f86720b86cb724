"""Camera rigs for the numeric core: keyframes of one session, held together by odometry.

Source: COVINS-G III-B2, Figure 2.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import covinz_core
import numpy as np

from covinz import frames
from covinz.keyframes import KeyframeStore
from covinz.types import Camera, Features, FeatureType, RigMember


class BadRig(ValueError):
    """A rig that cannot be formed from what its keyframes contain."""


def build_rig(
    members: Sequence[RigMember], store: KeyframeStore, kind: FeatureType
) -> list[covinz_core.RigCamera]:
    """The cameras of a rig in the body frame of its first member.

    ``T_rig_cam = inv(T_odom_body(first)) @ T_odom_body(member) @ T_body_cam``.

    Args:
        members: Keyframes of one session, with the poses that the job was made with.
        store: Where features and calibrations come from.
        kind: Which of their features to use.

    Raises:
        KeyframeNotFound, CameraNotFound, StoreUnavailable: From the store.
        BadRig: If a keyframe has no features of that kind.
        ValueError: If a calibration or an array is not what the core accepts.
    """
    T_rig_odom = frames.inverse(members[0].T_odom_body)
    return [_camera(member, T_rig_odom @ member.T_odom_body, store, kind) for member in members]


def _camera(
    member: RigMember, T_rig_body: frames.Array, store: KeyframeStore, kind: FeatureType
) -> covinz_core.RigCamera:
    features = store.keyframe(member.keyframe).features_of(kind)
    if features is None:
        raise BadRig(f"keyframe {member.keyframe} has no {kind.name} features")
    camera = store.camera(member.camera_hash)
    bearings = _bearings(features, camera)
    # Every model starts with fx, fy.
    focal_px = float(np.mean(camera.params[:2]))
    return covinz_core.RigCamera(
        T_rig_body @ camera.T_body_cam, bearings, features.descriptors, focal_px
    )


# By identity: a store gives the same objects as long as it remembers them. A keyframe is in several
# jobs that come soon after one another, and undistorting it takes longer than all else here; its
# bearings are about 26 kB.
@functools.lru_cache(maxsize=512)
def _bearings(features: Features, camera: Camera) -> frames.Array:
    bearings: frames.Array = covinz_core.bearing_vectors(
        camera.model, camera.params.tolist(), features.keypoints_px.astype(np.float64)
    )
    return bearings


@functools.lru_cache(maxsize=64)
def adjoint_cam_body(camera: Camera) -> frames.Array:
    """(6, 6) that carries a right perturbation of a body to its camera."""
    adjoint = frames.adjoint(frames.inverse(camera.T_body_cam))
    adjoint.setflags(write=False)
    return adjoint
