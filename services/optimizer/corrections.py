"""Corrections: where each robot's odometry frame is in its map, and whether that jumped."""

from __future__ import annotations

import numpy as np

from covinz.config import OptimizerConfig
from covinz.frames import Array, inverse, rotation_angle
from covinz.types import Correction
from services.optimizer.maps import PublishedMap
from services.optimizer.optimisation import Placement


def make_correction(
    published: PublishedMap,
    placement: Placement,
    previous: Correction | None,
    config: OptimizerConfig,
    stamp_ns: int,
) -> Correction:
    """The correction of a segment: ``T_map_odom = T_map_body(k) @ inv(T_odom_body(k))``.

    k is the newest optimised keyframe of the segment. Source: docs/conventions.md.

    Args:
        published: The map that the segment is in.
        placement: Of the segment.
        previous: The agent's last correction, perhaps of another session.
        config: Limits of a jump.
        stamp_ns: Time to put on it; a later one than `previous` has in any case, so that a clock
            that was set back does not make it look old.
    """
    map_id = published.estimate.map_id
    return Correction(
        keyframe=placement.keyframe,
        map_id=map_id,
        map_revision=published.revision,
        T_map_odom=placement.T_map_odom,
        jumped=previous is not None and _jumped(previous, map_id, placement, config),
        stamp_ns=stamp_ns if previous is None else max(stamp_ns, previous.stamp_ns + 1),
    )


def body_motion(T_before: Array, T_after: Array, T_odom_body: Array) -> tuple[float, float]:
    """How far a correction moves the robot itself: metres at the body, radians.

    The distance between the two frames would say little: far from the odom origin a small
    rotation moves the robot by metres.
    """
    moved = inverse(T_before @ T_odom_body) @ (T_after @ T_odom_body)
    return float(np.linalg.norm(moved[:3, 3])), float(rotation_angle(moved))


def _jumped(
    previous: Correction, map_id: str, placement: Placement, config: OptimizerConfig
) -> bool:
    # A new session has a new odom frame, so there is nothing that moved a little.
    if previous.map_id != map_id or previous.keyframe.segment != placement.keyframe.segment:
        return True
    metres, radians = body_motion(previous.T_map_odom, placement.T_map_odom, placement.T_odom_body)
    return metres > config.jump_m or radians > config.jump_rad
