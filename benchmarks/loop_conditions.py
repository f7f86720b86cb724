"""The kinds of generated loop problems: the ordinary ones, and what real images add to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

# Odometry between neighbouring keyframes, per axis: 1 cm and 0.2 degrees in all.
_ODOMETRY_SIGMA_M = 0.01 / np.sqrt(3)
_ODOMETRY_SIGMA_RAD = np.deg2rad(0.2) / np.sqrt(3)


@dataclass(frozen=True, slots=True)
class Condition:
    """What the problems of one kind have in common; the default is an ordinary loop.

    Attributes:
        noise_px: Standard deviation of a keypoint, per axis.
        outlier_share: Wrong matches among all matches.
        odometry_sigma_m: Error of the odometry between neighbouring keyframes, per axis.
        odometry_sigma_rad: Likewise.
        step_m: Range of the distances between neighbouring keyframes.
        step_turn_rad: Root mean square of the turn between them.
        loop_m: Range of the distances between the reference keyframes.
        loop_yaw_rad: Largest yaw between them.
        depth_m: Range of the depths of landmarks.
        forward: Rigs and loop lie close to one line, the optical axis.
        matches: Range of the number of matches of all pairs together, wrong ones included.
        wall_relief_m: All landmarks lie about so far before or behind a wall that the reference
            camera of the query faces; None for landmarks anywhere in `depth_m`.
        clusters: Landmarks lie in so many spots of the image; 0 for anywhere.
        shared_px: Standard deviation of the error that neighbouring keypoints of an image share.
        shared_length_px: Distance over which it fades.
        tail_share: Motions of the odometry that are five times as wrong as told.
        pitch_m: Wrong matches take a structure that repeats for its own copy this far away, all in
            one direction, so that they agree on one wrong loop; None for wrong ones of all kinds.
    """

    noise_px: float = 1.0
    outlier_share: float = 0.3
    odometry_sigma_m: float = _ODOMETRY_SIGMA_M
    odometry_sigma_rad: float = _ODOMETRY_SIGMA_RAD
    step_m: tuple[float, float] = (0.1, 0.6)
    step_turn_rad: float = np.deg2rad(3)
    loop_m: tuple[float, float] = (0.1, 1.5)
    loop_yaw_rad: float = np.deg2rad(25)
    depth_m: tuple[float, float] = (2.0, 15.0)
    forward: bool = False
    matches: tuple[float, float] = (900, 1600)
    wall_relief_m: float | None = None
    clusters: int = 0
    shared_px: float = 0.0
    shared_length_px: float = 120.0
    tail_share: float = 0.0
    pitch_m: float | None = None


_DEFAULT = Condition()
CONDITIONS: Mapping[str, Condition] = {
    "default": _DEFAULT,
    "half_noise": replace(_DEFAULT, noise_px=0.5),
    "outliers_50": replace(_DEFAULT, outlier_share=0.5),
    "outliers_60": replace(_DEFAULT, outlier_share=0.6),
    "odometry_noise": replace(
        _DEFAULT,
        odometry_sigma_m=np.sqrt(3) * _ODOMETRY_SIGMA_M,
        odometry_sigma_rad=np.sqrt(3) * _ODOMETRY_SIGMA_RAD,
    ),
    "short_baseline": replace(_DEFAULT, step_m=(0.05, 0.15), depth_m=(5.0, 15.0)),
    "forward": replace(_DEFAULT, forward=True, loop_yaw_rad=np.deg2rad(3)),
    # The rigs turn on the spot, so nothing tells how long the loop is.
    "pure_rotation": replace(_DEFAULT, step_m=(0.0, 0.0), step_turn_rad=np.deg2rad(8)),
}

# What real images have and the ordinary problems lack. A hand-held camera in a room: short steps,
# fewer matches, in spots, whose errors are not white, and an odometry that is sometimes much worse
# than it says.
_ROOM = replace(
    _DEFAULT,
    outlier_share=0.4,
    step_m=(0.1, 0.25),
    step_turn_rad=np.deg2rad(6),
    loop_m=(0.1, 0.7),
    depth_m=(1.5, 4.0),
    matches=(250, 500),
    clusters=15,
    shared_px=0.5,
    tail_share=0.1,
)
REAL_CONDITIONS: Mapping[str, Condition] = {
    "room": _ROOM,
    "few_matches": replace(_ROOM, matches=(150, 300)),
    "wall": replace(_ROOM, wall_relief_m=0.1),
    "shared_errors": replace(_ROOM, shared_px=1.0),
    "heavy_tails": replace(_ROOM, tail_share=0.4),
    "repeated": replace(_ROOM, pitch_m=0.4),
    "repeated_wall": replace(_ROOM, pitch_m=0.4, wall_relief_m=0.1),
    # Nothing in common but structure that looks alike: no loop may be found.
    "elsewhere": replace(_ROOM, outlier_share=1.0, matches=(250, 800)),
}
