"""How the cameras of a rig moved while they took their images, for the profile that allows for it.

A robot stamps an image with one time, and odometry gives the body's pose at that time. The image
belongs to some other moment nearby, and with a rolling shutter its rows to as many.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import covinz_core
import numpy as np

from covinz.keyframes import KeyframeStore
from covinz.types import Camera, RigMember
from services.loop_solver.rig import adjoint_cam_body


def rig_exposures(
    members: Sequence[RigMember], store: KeyframeStore, readout_s: float
) -> list[covinz_core.CameraExposure]:
    """One for each keyframe of a rig; at rest where the job does not say how it moved.

    The stamp is anywhere in the time of the read-out, so it is off from the middle of the image by
    ``readout / sqrt(12)``, the standard deviation of a uniform distribution.

    Args:
        members: Keyframes of one session, as in `build_rig`.
        store: Where the calibrations come from.
        readout_s: Time from the first row of an image to the last, where a camera does not say.

    Raises:
        CameraNotFound, StoreUnavailable: From the store.

    Source: decision 0025.
    """
    return [_exposure(member, store.camera(member.camera_hash), readout_s) for member in members]


def _exposure(member: RigMember, camera: Camera, readout_s: float) -> covinz_core.CameraExposure:
    seconds = readout_s if camera.readout_s is None else camera.readout_s
    twists = np.zeros((2, 6)) if member.twists is None else member.twists
    before, after = twists @ adjoint_cam_body(camera).T
    return covinz_core.CameraExposure(
        before, after, seconds / math.sqrt(12.0), seconds / camera.height
    )
