"""What odometry says about the motions inside a rig, for the profile that checks it.

A robot may send the covariance of the motion since its previous keyframe; where it does not, or
keyframes between two members are not at hand, its front-end's usual accuracy stands in.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import covinz_core
import numpy as np

from covinz import frames
from covinz.config import OdometryNoise
from covinz.keyframes import KeyframeStore
from covinz.types import Array, Keyframe, RigMember

# Nothing is measured better, however sure a front-end is of itself: 0.1 mrad and 1 mm. Keeps
# covariances positive definite that were sent for a robot that stood still.
_FLOOR = np.diag(np.repeat([1e-4**2, 1e-3**2], 3))
# A variance beyond this says nothing: a turn in full, or ten metres, between neighbours.
_MAX_VARIANCE = 100.0


def rig_motions(
    members: Sequence[RigMember], store: KeyframeStore, noise: OdometryNoise
) -> list[covinz_core.RigMotion]:
    """Motions between the neighbours of a rig in order of time; they tie all cameras together.

    Args:
        members: Keyframes of one session, the reference first, as in `build_rig`.
        store: Where the keyframes' covariances come from.
        noise: Accuracy of a front-end that sends none.

    Raises:
        KeyframeNotFound, CameraNotFound, StoreUnavailable: From the store.
    """
    motions = []
    for earlier, later in consecutive(members):
        a, b = members[earlier], members[later]
        T_a_b = frames.inverse(a.T_odom_body) @ b.T_odom_body
        adjacent = b.keyframe.seq == a.keyframe.seq + 1
        sent = _sent(store.keyframe(b.keyframe)) if adjacent else None
        covariance = (random_walk(T_a_b, noise) if sent is None else sent) + _FLOOR
        # From the later body to its camera: that is where the core takes perturbations.
        to_camera = frames.adjoint(frames.inverse(store.camera(b.camera_hash).T_body_cam))
        seen = to_camera @ covariance @ to_camera.T
        motions.append(covinz_core.RigMotion(earlier, later, 0.5 * (seen + seen.T)))
    return motions


def consecutive(members: Sequence[RigMember]) -> list[tuple[int, int]]:
    """Positions of the members of a rig that follow one another in time, earlier and later."""
    order = sorted(range(len(members)), key=lambda i: members[i].keyframe.seq)
    return list(pairwise(order))


def random_walk(T_a_b: Array, noise: OdometryNoise) -> Array:
    """(6, 6) covariance of a motion whose error grows with its metres and radians.

    Source: COVINS-G III-C.
    """
    moved_m = float(np.linalg.norm(T_a_b[:3, 3]))
    turned_rad = float(frames.rotation_angle(T_a_b))
    rotation = noise.rotation_per_sqrt_m**2 * moved_m + noise.rotation_per_sqrt_rad**2 * turned_rad
    translation = (
        noise.translation_per_sqrt_m**2 * moved_m + noise.translation_per_sqrt_rad**2 * turned_rad
    )
    rotation += noise.min_rotation**2
    translation += noise.min_translation**2
    return np.diag(np.repeat([rotation, translation], 3))


def _sent(keyframe: Keyframe) -> Array | None:
    """The covariance that came with a keyframe, if it is one."""
    covariance = keyframe.covariance
    if covariance is None or np.abs(covariance).max() > _MAX_VARIANCE:
        return None
    symmetric: Array = 0.5 * (covariance + covariance.T)
    size = np.abs(covariance).max()
    if np.abs(covariance - symmetric).max() > 1e-6 * size:
        return None
    return symmetric if np.linalg.eigvalsh(symmetric)[0] >= -1e-9 * size else None
