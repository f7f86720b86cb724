"""Where something can be put: away from given paths, and not into what stands there already."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from covinz.types import Array, frozen_array
from covinz_agents.world.builders import heading


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """An upright box that something fills.

    Attributes:
        base_m: (3,) centre of its bottom.
        size_m: (3,) length along its own x, width, height.
        yaw_rad: Turn of its x axis about the vertical.
    """

    base_m: Array
    size_m: Array
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in ("base_m", "size_m"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (3,)))

    @property
    def reach_m(self) -> float:
        """From its middle to a corner, seen from above."""
        return float(np.linalg.norm(self.size_m[:2])) / 2

    def distance_m(self, points_m: Array) -> float:
        """From the nearest of some points (N, 3); 0 when one is inside, inf without points."""
        low = self.base_m[2] - points_m[:, 2]
        above = np.maximum(np.maximum(low, -low - self.size_m[2]), 0.0)
        beside = self.beside_m(points_m)
        return float(np.sqrt((above**2 + beside**2).min(initial=np.inf)))

    def beside_m(self, points_m: Array) -> Array:
        """(N,) horizontal distances of points (N, 3); 0 above, in and below the box."""
        x, y = heading(self.yaw_rad)[:2], heading(self.yaw_rad + np.pi / 2)[:2]
        offset = (points_m[:, :2] - self.base_m[:2]) @ np.stack([x, y], axis=1)
        outside = np.maximum(np.abs(offset) - self.size_m[:2] / 2, 0.0)
        return np.asarray(np.hypot(outside[:, 0], outside[:, 1]))

    def overlaps(self, other: Bounds, gap_m: float) -> bool:
        """Whether another box is nearer than a gap, measured along the sides of the two."""
        low, high = self.base_m[2], self.base_m[2] + self.size_m[2]
        if other.base_m[2] >= high or other.base_m[2] + other.size_m[2] <= low:
            return False
        corners, others = self.footprint_m(), other.footprint_m()
        for yaw_rad in (self.yaw_rad, other.yaw_rad):
            for axis in (heading(yaw_rad)[:2], heading(yaw_rad + np.pi / 2)[:2]):
                a, b = corners @ axis, others @ axis
                if a.max() + gap_m <= b.min() or b.max() + gap_m <= a.min():
                    return False
        return True

    def footprint_m(self) -> Array:
        """(4, 2) its corners as seen from above."""
        x, y = heading(self.yaw_rad)[:2], heading(self.yaw_rad + np.pi / 2)[:2]
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
        corners: Array = self.base_m[:2] + signs * self.size_m[:2] @ np.stack([x, y])
        return corners


class FreeSpace:
    """What is still free in a hall.

    Args:
        keep_clear_m: (N, 3) points of paths.
        clearance_m: Nothing comes nearer to them than this.
        low_m: (3,) lower corner of the hall.
        high_m: (3,) its upper corner.
    """

    def __init__(
        self, keep_clear_m: ArrayLike, clearance_m: float, low_m: Array, high_m: Array
    ) -> None:
        self._paths = np.reshape(np.asarray(keep_clear_m, dtype=float), (-1, 3))
        self._clearance_m = clearance_m
        self._low, self._high = np.array(low_m), np.array(high_m)
        self._taken: list[Bounds] = []

    def height_m(self, place: Bounds) -> float:
        """How high a place may be with its footprint and base; inf where no path is near."""
        beside = place.beside_m(self._paths)
        near = beside < self._clearance_m
        needed_m = np.sqrt(self._clearance_m**2 - beside[near] ** 2)
        lowest_m = (self._paths[near, 2] - needed_m).min(initial=np.inf)
        return float(lowest_m - place.base_m[2])

    def is_taken(self, place: Bounds, gap_m: float) -> bool:
        """Whether something stands there already, or nearer than a gap."""
        # Turned boxes may be called near while their circles are not: sqrt(2) covers that.
        reach_m = place.reach_m + np.sqrt(2) * gap_m
        return any(
            np.hypot(*(place.base_m[:2] - other.base_m[:2])) < reach_m + other.reach_m
            and place.overlaps(other, gap_m)
            for other in self._taken
        )

    def take(self, bounds: Bounds, gap_m: float = 0.3) -> bool:
        """Take a place if it is free; says whether it was.

        Args:
            bounds: The place.
            gap_m: From what was put before.
        """
        corners = bounds.footprint_m()
        # A thousandth of slack: what stands against a wall is in the hall.
        low, high = self._low - 1e-3, self._high + 1e-3
        if (corners < low[:2]).any() or (corners > high[:2]).any():
            return False
        if bounds.base_m[2] + bounds.size_m[2] > high[2]:
            return False
        if self.is_taken(bounds, gap_m) or bounds.distance_m(self._paths) < self._clearance_m:
            return False
        self._taken.append(bounds)
        return True
