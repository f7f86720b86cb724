"""Which keyframes around a reference make the best rig, by odometry and calibration alone.

What makes one rig better than another is in ``core/include/covinz/rig_neighbours.h``.

Source: decision 0021.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import covinz_core

from covinz.config import MAX_RIG_SIZE, FastLoopConfig, RigConfig
from covinz.types import Array, Camera

Options = covinz_core.RigNeighboursOptions


@dataclass(frozen=True, slots=True)
class Choice:
    """A rig.

    Attributes:
        rows: The reference first, then the others in order of time.
        information: What it tells about scale: one over the relative variance.
    """

    rows: tuple[int, ...]
    information: float


def core_options(rigs: RigConfig, fast: FastLoopConfig) -> Options:
    """The core's options as configured.

    Args:
        rigs: What a rig should be like.
        fast: Odometry's accuracy, and the inlier threshold of the hypotheses.

    Raises:
        ValueError: If the core does not accept them.
    """
    made = Options()
    for name in ("depth_m", "half_view_change", "min_overlap", "max_path_m"):
        setattr(made, name, getattr(rigs, name))
    made.min_steps = MAX_RIG_SIZE - 1
    made.max_error_px = fast.max_error_px
    made.odometry = covinz_core.OdometryNoise(**fast.odometry.model_dump())
    made.check()
    return made


def choose(
    T_odom_body: Sequence[Array],
    cameras: Sequence[Camera],
    reference: int,
    size: int,
    options: Options,
) -> Choice:
    """The best rig around a keyframe.

    Where too few keyframes have enough of the reference's view, the places left go to those that
    can be matched best with it, of equal ones to the nearest. Only motions between the keyframes
    count, not the odometry's frame.

    Args:
        T_odom_body: N odometry poses (4, 4) of keyframes of one session in order of time.
        cameras: Their N calibrations.
        reference: Row of the keyframe that the rig is for.
        size: Keyframes in the rig; all N where there are fewer.
        options: See `core_options`.

    Raises:
        ValueError: If a calibration is not what the core accepts.
    """
    views = [_view(camera) for camera in cameras]
    rows, information = covinz_core.choose_rig(T_odom_body, views, reference, size, options)
    return Choice(tuple(rows), information)


@functools.lru_cache(maxsize=64)
def _view(camera: Camera) -> covinz_core.CameraView:
    return covinz_core.CameraView(
        camera.model, camera.params.tolist(), camera.width, camera.height, camera.T_body_cam
    )
