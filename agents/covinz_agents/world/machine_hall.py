"""A machine hall around given paths: what stands in it keeps its distance from them.

The walls stand at a margin from the paths; machines, tanks, racks, pipes and girders are put by
the seed wherever no path comes near, as high as the paths above them allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from covinz.scenario import MachineHallScene
from covinz.types import Array
from covinz_agents.world import machinery
from covinz_agents.world.builders import UP, heading, level, tiles, upright
from covinz_agents.world.free_space import Bounds, FreeSpace
from covinz_agents.world.geometry import Face, World

# Textures of walls and floor cover no more than this. [m]
_TILE_M = 4.0
# Places on the floor are tried on a grid this wide. [m]
_GRID_M = 0.9
_Range = tuple[float, float]
_Kind = tuple[machinery.Filling, _Range, _Range, _Range]
# What stands on the floor: filling, smallest and largest length, width and height [m].
# Large things are put first, small ones into the gaps.
_LARGE: tuple[_Kind, ...] = (
    (machinery.machine, (2.0, 3.6), (1.2, 2.0), (0.8, 2.8)),
    (machinery.tank, (1.6, 2.8), (1.6, 2.8), (0.9, 4.5)),
    (machinery.rack, (2.4, 4.0), (0.8, 1.1), (1.8, 4.4)),
)
_SMALL: tuple[_Kind, ...] = (
    (machinery.machine, (1.4, 2.0), (0.8, 1.2), (0.6, 1.8)),
    (machinery.crates, (0.8, 1.4), (0.8, 1.4), (0.5, 2.4)),
    (machinery.cabinets, (1.2, 2.4), (0.6, 0.9), (1.0, 2.3)),
    (machinery.workbench, (1.4, 2.4), (0.7, 1.0), (0.9, 1.6)),
)
# Between two things on the floor. [m]
_GAP_M = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Hall:
    """Corners of the hall, its free space and what it draws from."""

    low_m: Array
    high_m: Array
    free: FreeSpace
    rng: np.random.Generator

    def walls(self) -> list[tuple[Array, Array, float]]:
        """(middle of the foot, normal into the hall, length) of the four walls."""
        middle, half = (self.low_m + self.high_m) / 2, (self.high_m - self.low_m) / 2
        found = []
        for k in range(4):
            normal = -np.round(heading(k * np.pi / 2))
            foot = middle - normal * half
            foot[2] = self.low_m[2]
            found.append((foot, normal, float(2 * half[(k + 1) % 2])))
        return found


def machine_hall(scene: MachineHallScene, keep_clear_m: ArrayLike) -> World:
    """Build the hall.

    Args:
        scene: Its seed, and the distances kept.
        keep_clear_m: (N, 3) positions of all paths in it.

    Raises:
        ValueError: If there is no path.
    """
    paths = np.reshape(np.asarray(keep_clear_m, dtype=float), (-1, 3))
    if len(paths) == 0:
        raise ValueError("a machine hall is built around paths: give at least one that is known")
    # The floor is as near to the lowest path as may be: robots start from it.
    low = paths.min(axis=0) - [scene.margin_m, scene.margin_m, scene.clearance_m]
    high = paths.max(axis=0) + scene.margin_m
    if min(scene.margin_m, scene.clearance_m) < scene.clearance_m:
        raise ValueError("the margin of a machine hall cannot be smaller than its clearance")
    space = FreeSpace(paths, scene.clearance_m, low, high)
    hall = _Hall(low, high, space, np.random.default_rng([scene.seed, 0xA1]))
    faces = _shell(hall) + _girders(hall) + _along_walls(hall) + _on_floor(hall)
    return World(tuple(faces), low, high, outdoors=False, seed=scene.seed)


def _shell(hall: _Hall) -> list[Face]:
    """Floor, ceiling and walls, with windows high up."""
    size, middle = hall.high_m - hall.low_m, (hall.low_m + hall.high_m) / 2
    ground, roof = middle * [1, 1, 0], middle * [1, 1, 0]
    ground[2], roof[2] = hall.low_m[2], hall.high_m[2]
    faces = tiles(level(ground, 0.0, size[0], size[1], "floor"), _TILE_M)
    faces += tiles(level(roof, 0.0, size[0], size[1], "ceiling", facing_up=False), _TILE_M)
    for foot, normal, length in hall.walls():
        center = foot + size[2] / 2 * UP
        faces += tiles(upright(center, normal, length, size[2], "wall"), _TILE_M)
        along = np.cross(UP, normal)
        for at_m in np.arange(-length / 2 + 2.0, length / 2 - 1.5, 4.0):
            pane = foot + at_m * along + (size[2] - 1.4) * UP + 0.03 * normal
            faces.append(upright(pane, normal, 2.4, 1.4, "window"))
    return faces


def _girders(hall: _Hall) -> list[Face]:
    """Beams under the roof every few metres, and a duct below them."""
    size, middle = hall.high_m - hall.low_m, (hall.low_m + hall.high_m) / 2
    faces = []
    for x in np.arange(hall.low_m[0] + 2.5, hall.high_m[0] - 1.0, 4.5):
        base = np.array([x, middle[1], hall.high_m[2] - 0.7])
        faces += _put(
            hall, machinery.girder, Bounds(base, np.array([size[1], 0.35, 0.6]), np.pi / 2), 0.0
        )
    for share in (0.2, 0.5, 0.8):
        y = hall.low_m[1] + share * size[1]
        base = np.array([middle[0], y, hall.high_m[2] - 1.5])
        faces += _put(hall, machinery.duct, Bounds(base, np.array([size[0], 0.7, 0.7])), 0.0)
    return faces


def _along_walls(hall: _Hall) -> list[Face]:
    """Pillars and pipes along the walls, and notices on them."""
    faces = []
    for foot, normal, length in hall.walls():
        along = np.cross(UP, normal)
        yaw_rad = float(np.arctan2(along[1], along[0]))
        for at_m in np.arange(-length / 2 + 0.5, length / 2, 5.0):
            base = foot + at_m * along + 0.2 * normal
            height_m = hall.high_m[2] - hall.low_m[2] - 1.6
            faces += _put(
                hall, machinery.pillar, Bounds(base, np.array([0.5, 0.4, height_m]), yaw_rad), 0.0
            )
        for high_m in hall.rng.uniform([2.8, 4.2], [3.6, 5.0]):
            base = foot + 0.65 * normal + high_m * UP
            faces += _put(
                hall, machinery.duct, Bounds(base, np.array([length - 1.6, 0.4, 0.4]), yaw_rad), 0.0
            )
        for at_m in np.arange(-length / 2 + 3.0, length / 2 - 2.0, 5.0):
            center = foot + at_m * along + 0.04 * normal + hall.rng.uniform(1.6, 2.4) * UP
            size = hall.rng.uniform([1.0, 0.8], [2.2, 1.3])
            faces.append(upright(center, normal, float(size[0]), float(size[1]), "poster"))
    return faces


def _on_floor(hall: _Hall) -> list[Face]:
    """Machines and stores wherever there is room."""
    xs, ys = (np.arange(hall.low_m[i] + 0.8, hall.high_m[i] - 0.8, _GRID_M) for i in (0, 1))
    spots = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    faces = []
    for kinds in (_LARGE, _SMALL):
        for spot in hall.rng.permutation(spots):
            faces += _stand(hall, kinds, np.append(spot, hall.low_m[2]))
    return faces


def _stand(hall: _Hall, kinds: Sequence[_Kind], base: Array) -> list[Face]:
    """Something at a spot, as high as it can be; nothing if there is no room."""
    filling, length_m, width_m, height_m = kinds[int(hall.rng.integers(len(kinds)))]
    length, width = float(hall.rng.uniform(*length_m)), float(hall.rng.uniform(*width_m))
    yaw_rad = float(hall.rng.integers(4)) * np.pi / 2 + float(hall.rng.normal(0, 0.08))
    height = height_m[1] * float(hall.rng.uniform(0.75, 1.0))
    if hall.free.is_taken(Bounds(base, np.array([length, width, height_m[0]]), yaw_rad), _GAP_M):
        return []
    # A thousandth of slack against rounding.
    free_m = hall.free.height_m(Bounds(base, np.array([length, width, height]), yaw_rad)) - 1e-3
    if free_m < height_m[0]:
        return []
    size = np.array([length, width, min(height, free_m)])
    return _put(hall, filling, Bounds(base, size, yaw_rad), _GAP_M)


def _put(hall: _Hall, filling: machinery.Filling, place: Bounds, gap_m: float) -> list[Face]:
    """A filled place, if it is free."""
    return filling(place, hall.rng) if hall.free.take(place, gap_m) else []
