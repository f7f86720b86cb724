"""What odometry says about the motions inside a rig, for the profile that checks it.

Jobs carry it: place recognition sees every keyframe between two members and what the robot sent
with it. Where a job does not, the front-end's usual accuracy stands in.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import covinz_core

from covinz.config import OdometryNoise
from covinz.keyframes import KeyframeStore
from covinz.types import RigMember
from services.loop_solver.rig import adjoint_cam_body


def rig_motions(
    members: Sequence[RigMember], store: KeyframeStore, noise: OdometryNoise
) -> list[covinz_core.RigMotion]:
    """Motions between the neighbours of a rig in order of time; they tie all cameras together.

    Args:
        members: Keyframes of one session, the reference first, as in `build_rig`.
        store: Where the calibrations come from.
        noise: Accuracy of a front-end that nothing is known of.

    Raises:
        CameraNotFound, StoreUnavailable: From the store.
    """
    motions = []
    for earlier, later in consecutive(members):
        a, b = members[earlier], members[later]
        covariance = b.motion_covariance
        if covariance is None:
            usual = covinz_core.OdometryNoise(**noise.model_dump())
            T_odom_body = [a.T_odom_body, b.T_odom_body]
            covariance = covinz_core.motion_covariance(T_odom_body, [None], usual)
        # From the later body to its camera: that is where the core takes perturbations.
        to_camera = adjoint_cam_body(store.camera(b.camera_hash))
        seen = to_camera @ covariance @ to_camera.T
        motions.append(covinz_core.RigMotion(earlier, later, 0.5 * (seen + seen.T)))
    return motions


def consecutive(members: Sequence[RigMember]) -> list[tuple[int, int]]:
    """Positions of the members of a rig that follow one another in time, earlier and later."""
    order = sorted(range(len(members)), key=lambda i: members[i].keyframe.seq)
    return list(pairwise(order))
