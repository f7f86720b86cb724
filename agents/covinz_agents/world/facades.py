"""Fronts of buildings: houses in a row with doors, balconies, bays, awnings, signs and roofs."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from covinz.types import Array
from covinz_agents.world.builders import UP, box, upright
from covinz_agents.world.geometry import Face

STOREY_M = 3.3
# A roof rises over this depth behind the eaves. [m]
_ROOF_DEPTH_M = 2.2
_FRONTS = ("plaster_facade", "brick_facade", "stone_facade")


@dataclass(frozen=True, slots=True, eq=False)
class House:
    """One house of a row, which looks to the right of the way along the row.

    Attributes:
        start_m: (3,) where its front begins, on the ground.
        along: (3,) unit vector along the row.
        width_m: Of its front.
        storeys: How many it has.
        roof_m: How far the roof rises above the eaves.
    """

    start_m: Array
    along: Array
    width_m: float
    storeys: int
    roof_m: float

    @property
    def facing(self) -> Array:
        """(3,) unit normal of the front."""
        normal: Array = np.cross(self.along, UP)
        return normal

    @property
    def yaw_rad(self) -> float:
        """Angle of `along` from x: the front of a box with this yaw looks as the house does."""
        return float(np.arctan2(self.along[1], self.along[0]))

    @property
    def eaves_m(self) -> float:
        """Height of the front."""
        return self.storeys * STOREY_M + 0.6

    @property
    def ridge_m(self) -> float:
        """Height of the top of the roof."""
        return self.eaves_m + self.roof_m

    def panel(self, at_m: float, low_m: float, size_m: tuple[float, float], material: str) -> Face:
        """A (width, height) face 0.12 m before the front: a door, a window, a sign."""
        center = self.start_m + at_m * self.along + (low_m + size_m[1] / 2) * UP
        return upright(center + 0.12 * self.facing, self.facing, size_m[0], size_m[1], material)

    def block(
        self, at_m: float, low_m: float, size_m: tuple[float, float, float], material: str
    ) -> list[Face]:
        """A box (width, depth, height) that juts out of the front, seen from below."""
        base = self.start_m + at_m * self.along + low_m * UP + size_m[1] / 2 * self.facing
        return box(base, size_m, material, yaw_rad=self.yaw_rad, without=("top", "back"))


def outline(
    corners_m: Sequence[tuple[float, float]], rng: np.random.Generator, house_m: float = 16.0
) -> list[Face]:
    """Houses along a closed polygon.

    Args:
        corners_m: (x, y) of its corners; counter-clockwise the houses look out of it, clockwise
            into it.
        rng: Draws widths, heights, materials and what is on the fronts.
        house_m: About how wide a house is.
    """
    ends = [*corners_m[1:], corners_m[0]]
    return [
        face
        for start, end in zip(corners_m, ends, strict=True)
        for face in row(start, end, rng, house_m)
    ]


def row(
    start_m: ArrayLike, end_m: ArrayLike, rng: np.random.Generator, house_m: float = 16.0
) -> list[Face]:
    """Houses side by side between two points (x, y); they look to the right of the way."""
    start, end = np.append(start_m, 0.0), np.append(end_m, 0.0)
    whole_m = float(np.linalg.norm(end - start))
    along = (end - start) / whole_m
    shares = rng.uniform(0.8, 1.2, max(1, round(whole_m / house_m)))
    widths = shares / shares.sum() * whole_m
    starts = np.cumsum(widths) - widths
    houses = [
        House(start + at_m * along, along, float(width_m),
              int(rng.integers(2, 5)), float(rng.uniform(2.0, 3.2)))
        for at_m, width_m in zip(starts, widths, strict=True)
    ]  # fmt: skip
    faces = [face for house in houses for face in _front(house, rng)]
    faces += [_back(house, house is houses[0], house is houses[-1]) for house in houses]
    return faces + [_gable(a, b) for a, b in itertools.pairwise(houses)]


def _front(house: House, rng: np.random.Generator) -> list[Face]:
    """The wall with a door, the roof, and some of what houses have."""
    material = _FRONTS[int(rng.integers(len(_FRONTS)))]
    middle = house.start_m + house.width_m / 2 * house.along + house.eaves_m / 2 * UP
    door_m = float(rng.uniform(1.5, house.width_m - 1.5))
    faces = [
        upright(middle, house.facing, house.width_m, house.eaves_m, material),
        house.panel(door_m, 0.0, (1.5, 2.7), "door"),
        *_roof(house, rng),
    ]
    if rng.random() < 0.5:
        faces += _shop(house, door_m)
    for _ in range(int(house.width_m // 6)):
        faces += _jutting(house, rng)
    return faces


def _roof(house: House, rng: np.random.Generator) -> list[Face]:
    """A cornice, a slope of tiles above it and perhaps a chimney."""
    top = house.start_m + house.ridge_m * UP - _ROOF_DEPTH_M * house.facing
    down = _ROOF_DEPTH_M * house.facing - house.roof_m * UP
    faces = [Face(top, house.width_m * house.along, down, "roof_tiles")]
    size = (house.width_m - 0.2, 0.4, 0.5)
    faces += house.block(house.width_m / 2, house.eaves_m - 0.4, size, "cornice")
    if rng.random() < 0.4:
        foot = top + float(rng.uniform(1.0, house.width_m - 1.0)) * house.along
        faces += box(foot - UP, (0.8, 0.8, 2.4), "garden_wall", without=("top", "bottom"))
    return faces


def _shop(house: House, door_m: float) -> list[Face]:
    """A shop window under an awning, on the side of the door where there is more room."""
    left = door_m > house.width_m / 2
    room_m = (door_m if left else house.width_m - door_m) - 1.6
    if room_m < 2.5:
        return []
    width_m = min(room_m, 5.0)
    away_m = 1.0 + width_m / 2
    at_m = door_m - away_m if left else door_m + away_m
    window = house.panel(at_m, 0.4, (width_m, 2.3), "shop_front")
    return [window, *house.block(at_m, 2.85, (width_m + 0.2, 1.1, 0.3), "awning")]


def _jutting(house: House, rng: np.random.Generator) -> list[Face]:
    """A balcony, a bay or a sign."""
    at_m = float(rng.uniform(2.0, house.width_m - 2.0))
    level_m = STOREY_M * int(rng.integers(1, house.storeys)) + 0.6
    kind = rng.random()
    if kind < 0.35:
        return house.block(at_m, level_m, (2.6, 1.0, 1.0), "balcony")
    if kind < 0.6:
        return house.block(at_m, level_m - 0.3, (2.2, 0.7, 2.7), "bay")
    return [house.panel(at_m, 3.2, (float(rng.uniform(1.5, 3.0)), 0.8), "sign")]


def _back(house: House, first: bool, last: bool) -> Face:
    """What is seen of a house from behind over lower ones; it ends where the next row begins."""
    from_m = _ROOF_DEPTH_M if first else 0.0
    to_m = house.width_m - (_ROOF_DEPTH_M if last else 0.0)
    low_m = STOREY_M
    center = house.start_m + (from_m + to_m) / 2 * house.along + (low_m + house.ridge_m) / 2 * UP
    center = center - _ROOF_DEPTH_M * house.facing
    return upright(center, -house.facing, to_m - from_m, house.ridge_m - low_m, "plaster")


def _gable(left: House, right: House) -> Face:
    """What is seen of the higher of two neighbours above the eaves of the lower one."""
    high, low = (left, right) if left.ridge_m > right.ridge_m else (right, left)
    outward = left.along if high is left else -left.along
    center = right.start_m + (low.eaves_m + high.ridge_m) / 2 * UP
    center = center - _ROOF_DEPTH_M / 2 * left.facing
    return upright(center, outward, _ROOF_DEPTH_M, high.ridge_m - low.eaves_m, "plaster")
