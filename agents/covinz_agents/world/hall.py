"""An industrial hall: machines and stores along its walls, free space in its middle.

The plan scales with the size of the hall; what stands where, and how it looks, is drawn by the
seed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from covinz.scenario.scenes import HallScene
from covinz.types import Array
from covinz_agents.world import machinery
from covinz_agents.world.builders import UP, box, level, pipe, tiles, upright
from covinz_agents.world.free_space import Bounds
from covinz_agents.world.geometry import Face, World

# Walls, floor and roof are made of squares of about this size. [m]
_TILE_M = 4.0
# Depth of the strip along the walls in which things stand. [m]
_STRIP_M = 1.7
# Free space under the roof, where beams, ducts, lamps and hanging things are. [m]
_UNDER_ROOF_M = 3.2
# What may stand along a wall: filling, range of lengths, of depths and of heights. [m]
_Filling = tuple[machinery.Filling, tuple[float, float], tuple[float, float], tuple[float, float]]
_ALONG_WALLS: Sequence[_Filling] = (
    (machinery.machine, (2.0, 3.2), (1.2, 1.5), (1.8, 2.5)),
    (machinery.rack, (2.4, 3.4), (0.9, 1.1), (3.0, 4.4)),
    (machinery.tank, (1.3, 1.5), (1.3, 1.5), (2.4, 4.0)),
    (machinery.cabinets, (1.8, 2.8), (0.6, 0.8), (1.9, 2.3)),
    (machinery.workbench, (1.8, 2.4), (0.8, 1.0), (1.5, 1.9)),
    (machinery.crates, (1.0, 1.3), (1.0, 1.3), (1.2, 2.4)),
)


def hall(scene: HallScene) -> World:
    """Build the hall.

    Raises:
        ValueError: If it is too small for anything to move in it.
    """
    length, width, height = scene.size_m
    if min(length, width) < 4 * _STRIP_M or height < _UNDER_ROOF_M + 1.5:
        raise ValueError(
            f"a hall is at least {4 * _STRIP_M} m long and wide and {_UNDER_ROOF_M + 1.5} m high"
        )
    rng = np.random.default_rng([scene.seed, 0xB7])
    half = np.array([length / 2, width / 2])
    faces = _shell(half, height, rng) + _roof(half, height, rng) + _pillars(half, height, rng)
    for k in range(4):
        faces += _along_wall(half, k, rng)
    faces += _middle(half, rng) + _floor_lines(half)
    inside = half - _STRIP_M
    low, high = np.array([*-inside, 0.3]), np.array([*inside, height - _UNDER_ROOF_M])
    return World(tuple(faces), low, high, outdoors=False, seed=scene.seed)


def _wall(half: Array, k: int) -> tuple[Array, Array, Array, float]:
    """Middle of the foot, normal into the hall, direction to the right, and length of a wall."""
    normal = np.array([[-1.0, 0, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0]][k])
    foot = -normal * [half[0], half[1], 0]
    return foot, normal, np.cross(UP, normal), float(2 * half[(k + 1) % 2])


def _shell(half: Array, height: float, rng: np.random.Generator) -> list[Face]:
    """Floor, roof, and walls of panels or bricks below and sheets above, with windows."""
    length, width = 2 * half
    faces = tiles(level(np.zeros(3), 0.0, length, width, "floor"), _TILE_M)
    faces += tiles(level(height * UP, 0.0, length, width, "ceiling", facing_up=False), _TILE_M)
    split = 0.5 * height
    for k in range(4):
        foot, normal, right, extent = _wall(half, k)
        below = "brick_wall" if k % 2 else "wall"
        for low, high, material in ((0.0, split, below), (split, height, "cladding")):
            center = foot + (low + high) / 2 * UP
            faces += tiles(upright(center, normal, extent, high - low, material), _TILE_M)
        for at_m in np.arange(-extent / 2 + 2.2, extent / 2 - 1.5, 3.6):
            if rng.random() < 0.8:
                pane = foot + at_m * right + (height - 1.75) * UP + 0.03 * normal
                faces.append(upright(pane, normal, 2.4, 1.5, "window"))
        faces += _on_wall(half, height, k, rng)
    return faces


def _on_wall(half: Array, height: float, k: int, rng: np.random.Generator) -> list[Face]:
    """A gate in two of the walls, notices, and pipes above the machines."""
    foot, normal, right, extent = _wall(half, k)
    faces = []
    if k % 2 == 0:
        center = foot + 1.9 * UP + 0.06 * normal + rng.uniform(-0.1, 0.1) * extent * right
        faces.append(upright(center, normal, 3.4, 3.8, "gate"))
    spots = np.arange(-extent / 2 + 1.5, extent / 2 - 1.0, 2.2)
    for at_m, high_m in zip(spots, rng.uniform(2.7, 0.5 * height + 0.4, len(spots)), strict=True):
        size = rng.uniform([0.7, 0.6], [1.5, 1.1])
        center = foot + (at_m + rng.uniform(-0.4, 0.4)) * right + high_m * UP + 0.09 * normal
        faces.append(upright(center, normal, float(size[0]), float(size[1]), "poster"))
    for high_m in rng.uniform([0.56 * height, 0.62 * height], [0.6 * height, 0.68 * height]):
        radius = float(rng.uniform(0.08, 0.16))
        ends = [foot + s * (extent / 2 - 0.3) * right + high_m * UP + 0.3 * normal for s in (-1, 1)]
        faces += pipe(ends[0], ends[1], radius, "pipe")
    return faces


def _roof(half: Array, height: float, rng: np.random.Generator) -> list[Face]:
    """Girders across, a duct and a crane along, lamps between, and what hangs from them."""
    faces = []
    stations = np.linspace(-half[0] + 2.0, half[0] - 2.0, max(2, round(half[0] / 1.9)))
    for x in stations:
        place = Bounds(
            np.array([x, 0, height - 0.75]), np.array([2 * half[1], 0.3, 0.6]), np.pi / 2
        )
        faces += machinery.girder(place, rng)
    for side in (-1, 1):
        base = np.array([0, side * 0.62 * half[1], height - 1.6])
        faces += machinery.duct(Bounds(base, np.array([2 * half[0] - 1, 0.6, 0.6])), rng)
    for x in (stations[1:] + stations[:-1]) / 2:
        for y in np.linspace(-0.55, 0.55, 3) * half[1]:
            faces += _lamp(np.array([x, y, height - 1.9]), height)
    for x in stations[1:-1]:
        faces += _hanging(np.array([x, rng.uniform(-0.45, 0.45) * half[1], 0]), height, rng)
    return faces


def _lamp(at_m: Array, height: float) -> list[Face]:
    """A box that shines downwards, on a rod."""
    sides = {"bottom": "lamp", "other": "steel"}
    faces = box(at_m, (1.3, 0.45, 0.16), sides, without=())
    return faces + pipe(at_m + 0.16 * UP, [*at_m[:2], height], 0.025, "steel", sides=3)


def _hanging(at_m: Array, height: float, rng: np.random.Generator) -> list[Face]:
    """A sign with both sides painted, or a hoist with its load."""
    low_m = height - _UNDER_ROOF_M + float(rng.uniform(0.2, 0.5))
    yaw_rad = float(rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.15))
    base = at_m + low_m * UP
    if rng.random() < 0.6:
        sides = {"front": "poster", "back": "poster", "other": "steel"}
        body = (float(rng.uniform(1.2, 1.8)), 0.08, 0.8)
        faces = box(base, body, sides, yaw_rad=yaw_rad, without=())
    else:
        body = (0.9, 0.6, 0.7)
        faces = box(base, body, "hazard", yaw_rad=yaw_rad, without=())
    return faces + pipe(base + body[2] * UP, [*at_m[:2], height - 0.7], 0.03, "steel", sides=3)


def _pillars(half: Array, height: float, rng: np.random.Generator) -> list[Face]:
    """Two rows of pillars with protected feet and boards on them."""
    faces = []
    for x in np.array([-0.52, 0.52]) * half[0]:
        for y in np.array([-0.5, 0.5]) * half[1]:
            base = np.array([x, y, 0])
            faces += machinery.pillar(Bounds(base, np.array([0.5, 0.5, height - 0.75])), rng)
            for normal in ([1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]):
                center = base + 0.29 * np.array(normal) + rng.uniform(1.9, 2.9) * UP
                faces.append(upright(center, normal, 0.44, 0.6, "poster"))
    return faces


def _along_wall(half: Array, k: int, rng: np.random.Generator) -> list[Face]:
    """Machines and stores side by side, their backs to the wall."""
    foot, normal, right, extent = _wall(half, k)
    # Fronts look along -y of a place's own axes.
    yaw_rad = float(np.arctan2(right[1], right[0]))
    faces: list[Face] = []
    at_m = -extent / 2 + (_STRIP_M + 0.3 if k % 2 else 0.4)
    end_m = extent / 2 - (_STRIP_M + 0.3 if k % 2 else 0.4)
    order = rng.permutation(len(_ALONG_WALLS) * 4) % len(_ALONG_WALLS)
    for kind in order:
        filling, *ranges = _ALONG_WALLS[int(kind)]
        length, depth, high = (float(rng.uniform(*limits)) for limits in ranges)
        if at_m + length > end_m:
            continue
        base = foot + (at_m + length / 2) * right + (depth / 2 + 0.15) * normal
        faces += filling(Bounds(base, np.array([length, depth, high]), yaw_rad), rng)
        at_m += length + float(rng.uniform(0.25, 0.7))
    return faces


def _middle(half: Array, rng: np.random.Generator) -> list[Face]:
    """Low piles of goods beside the pillars."""
    faces = []
    for x in np.array([-0.52, 0.52]) * half[0]:
        for y in np.array([-0.5, 0.5]) * half[1]:
            if rng.random() < 0.75:
                side = float(rng.choice([-1, 1]))
                size = np.array([*rng.uniform(0.8, 1.1, 2), rng.uniform(0.7, 1.3)])
                place = Bounds(np.array([x + side * 1.05, y, 0]), size, float(rng.normal(0, 0.1)))
                faces += machinery.crates(place, rng)
    return faces


def _floor_lines(half: Array) -> list[Face]:
    """Yellow lines between the strip of machines and the lanes."""
    x, y = half - _STRIP_M - 0.25
    thick = 0.12
    faces = []
    for side in (-1, 1):
        along_x = level([0, side * y, 0.006], 0.0, 2 * x + thick, thick, "floor_line")
        along_y = level([side * x, 0, 0.006], np.pi / 2, 2 * y - thick, thick, "floor_line")
        faces += tiles(along_x, _TILE_M) + tiles(along_y, _TILE_M)
    return faces
