"""What every front-end gives the player: frames with odometry, and features on demand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from covinz.trajectory import Trajectory
from covinz.types import Array, Camera, Features, frozen_array


class DatasetError(ValueError):
    """A recording that cannot be played; the message names the file and, in lists, the line."""


class RenderingStopped(RuntimeError):
    """Rendering was stopped before all images were there; those that are stay in the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """An image of a robot before anybody has looked at it.

    Attributes:
        number: Which of the source's images.
        stamp_ns: Time of exposure.
        T_odom_body: (4, 4) odometry at that time.
        gravity_body: (3,) unit direction of gravity in the body frame, where it was measured.
    """

    number: int
    stamp_ns: int
    T_odom_body: Array
    gravity_body: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_odom_body", frozen_array(self.T_odom_body, (4, 4)))
        if self.gravity_body is not None:
            object.__setattr__(self, "gravity_body", frozen_array(self.gravity_body, (3,)))


class Source(Protocol):
    """A recording or a rendered robot."""

    @property
    def camera(self) -> Camera:
        """Calibration of all frames."""

    @property
    def frames(self) -> Sequence[Frame]:
        """All frames with a pose, in stamp order."""

    @property
    def skipped(self) -> int:
        """Images left out because the odometry has no pose for them."""

    @property
    def groundtruth(self) -> Trajectory | None:
        """True poses ``T_world_body``, if they are known."""

    def image(self, frame: Frame) -> NDArray[np.uint8]:
        """A frame's image, (H, W) grey or (H, W, 3) BGR; raises DatasetError."""

    def features(self, frame: Frame) -> Features:
        """Features of a frame's first kind; raises DatasetError if its image cannot be read."""

    def all_features(self, frame: Frame) -> tuple[Features, ...]:
        """Features of a frame, one block for each kind; raises as `features`."""
