"""What stands in an industrial hall: machines, tanks, racks, crates, cabinets, benches.

Every function fills a place: `Bounds` that nothing juts out of.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from covinz.types import Array
from covinz_agents.world.builders import UP, box, column, heading, lid, pipe
from covinz_agents.world.free_space import Bounds
from covinz_agents.world.geometry import Face

Filling = Callable[[Bounds, np.random.Generator], list[Face]]


def _within(place: Bounds, along: float, across: float) -> Array:
    """(3,) a point of the floor of a place, by shares from -0.5 to 0.5 of its sides."""
    x, y = heading(place.yaw_rad), heading(place.yaw_rad + np.pi / 2)
    point: Array = place.base_m + along * place.size_m[0] * x + across * place.size_m[1] * y
    return point


def machine(place: Bounds, rng: np.random.Generator) -> list[Face]:
    """A bed, a head above one end of it, a panel of switches and a pipe along it."""
    length, width, height = place.size_m
    bed_m, share = height * float(rng.uniform(0.45, 0.6)), float(rng.uniform(0.35, 0.5))
    side = float(rng.choice([-1, 1]))
    sides = {"other": "machine", "front": "switches", "back": "switches"}
    bed = box(place.base_m, (length, width, bed_m), sides, yaw_rad=place.yaw_rad)
    at = _within(place, side * (0.5 - share / 2) * 0.96, 0.0) + bed_m * UP
    head = (share * length, 0.8 * width, height - bed_m)
    faces = bed + box(at, head, "machine", yaw_rad=place.yaw_rad)
    ends = [_within(place, side * t, 0.3) + (bed_m + 0.12) * UP for t in (0.5 - share, -0.5)]
    return faces + pipe(ends[0], ends[1], 0.1, "pipe", sides=6)


def tank(place: Bounds, rng: np.random.Generator) -> list[Face]:
    """A round vessel on a plinth, with a cap."""
    radius_m, height = float(min(place.size_m[:2])) / 2, float(place.size_m[2])
    foot_m = 0.12 * height
    foot = box(place.base_m, (1.4 * radius_m, 1.4 * radius_m, foot_m), "concrete",
               yaw_rad=place.yaw_rad, without=("top", "bottom"))  # fmt: skip
    low, cap_m = place.base_m + foot_m * UP, 0.1 * height
    body = column(low, radius_m, height - foot_m - cap_m, "tank")
    top = place.base_m + (height - cap_m) * UP
    faces = foot + body + lid(low, radius_m, "tank", facing_up=False) + lid(top, radius_m, "tank")
    cap = column(top, 0.4 * radius_m, cap_m, "pipe", sides=6)
    return faces + cap + lid(top + cap_m * UP, 0.4 * radius_m, "pipe", sides=6)


def rack(place: Bounds, rng: np.random.Generator) -> list[Face]:
    """Boards on posts, with crates on them."""
    length, width, height = place.size_m
    levels = max(1, int(height // 1.1))
    faces = []
    for along in (-0.5, 0.5):
        at = _within(place, along * (1 - 0.1 / length), 0.0)
        faces += box(at, (0.1, width, height), "steel", yaw_rad=place.yaw_rad)
    for k in range(levels):
        low = place.base_m + (0.1 + k * height / levels) * UP
        board = (length - 0.2, width, 0.06)
        faces += box(low, board, "steel", yaw_rad=place.yaw_rad, without=("left", "right"))
        room = Bounds(
            low + 0.06 * UP, np.array([length - 0.4, width, height / levels - 0.25]), place.yaw_rad
        )
        faces += _crates_side_by_side(room, rng)
    return faces


def _crates_side_by_side(room: Bounds, rng: np.random.Generator) -> list[Face]:
    length, width, height = room.size_m
    number = max(1, int(length // 0.9))
    faces = []
    for k in range(number):
        if rng.random() < 0.8:
            size = (length / number * rng.uniform(0.55, 0.95), width * rng.uniform(0.6, 0.95),
                    height * rng.uniform(0.4, 0.98))  # fmt: skip
            at = _within(room, (k + 0.5) / number - 0.5, 0.0)
            faces += box(at, size, "crate", yaw_rad=room.yaw_rad)
    return faces


def crates(place: Bounds, rng: np.random.Generator) -> list[Face]:
    """A pile: each crate a little smaller than the one below."""
    faces, low, size = [], 0.0, np.array(place.size_m)
    layers = max(1, round(size[2] / 0.8))
    for _ in range(layers):
        base = place.base_m + low * UP
        turn = float(rng.uniform(-0.1, 0.1)) if low else 0.0
        layer = (size[0], size[1], place.size_m[2] / layers)
        faces += box(base, layer, "crate", yaw_rad=place.yaw_rad + turn)
        low += layer[2]
        size[:2] *= rng.uniform(0.7, 0.85, 2)
    return faces


def cabinets(place: Bounds, rng: np.random.Generator) -> list[Face]:
    """A row of switch cabinets of different heights."""
    length, width, height = place.size_m
    number = max(1, round(length / 0.9))
    faces = []
    for k in range(number):
        at = _within(place, (k + 0.5) / number - 0.5, 0.0)
        size = (length / number - 0.04, width, height * (1.0 if k == 0 else rng.uniform(0.7, 1.0)))
        sides = {"front": "switches", "back": "machine", "other": "steel"}
        faces += box(at, size, sides, yaw_rad=place.yaw_rad)
    return faces


def workbench(place: Bounds, rng: np.random.Generator) -> list[Face]:
    """A table with drawers below and tools on it."""
    length, width, height = place.size_m
    table_m = 0.6 * height
    body = {"front": "switches", "other": "wood"}
    faces = box(place.base_m, (length, width, table_m), body, yaw_rad=place.yaw_rad)
    room = Bounds(
        place.base_m + table_m * UP,
        np.array([length, 0.8 * width, height - table_m]),
        place.yaw_rad,
    )
    return faces + _crates_side_by_side(room, rng)


def duct(place: Bounds, rng: np.random.Generator) -> list[Face]:
    """A pipe along the place's length, with two collars."""
    radius_m = float(min(place.size_m[1:])) / 2
    middle = place.size_m[2] / 2 * UP
    ends = [_within(place, side, 0.0) + middle for side in (-0.5, 0.5)]
    faces = pipe(ends[0], ends[1], 0.85 * radius_m, "pipe", sides=8)
    axis = heading(place.yaw_rad)
    for share in rng.uniform(-0.4, 0.4, 2):
        at = _within(place, float(share), 0.0) + middle
        faces += pipe(at - 0.1 * axis, at + 0.1 * axis, radius_m, "steel", sides=8)
    return faces


def girder(place: Bounds, rng: np.random.Generator) -> list[Face]:
    """A crane's or a roof's beam: two flanges and a web, seen from the sides and below."""
    length, width, height = place.size_m
    plate_m = 0.12 * height
    faces = []
    for low_m, size in ((0.0, (length, width, plate_m)),
                        (height - plate_m, (length, width, plate_m)),
                        (plate_m, (length, 0.3 * width, height - 2 * plate_m))):  # fmt: skip
        ends = ("left", "right") if low_m else ("left", "right", "top")
        faces += box(place.base_m + low_m * UP, size, "girder", yaw_rad=place.yaw_rad, without=ends)
    return faces


def pillar(place: Bounds, rng: np.random.Generator) -> list[Face]:
    """A square pillar without a top, its foot painted against trucks."""
    size = (place.size_m[0], place.size_m[1], float(place.size_m[2]))
    shaft = box(place.base_m, size, "concrete", yaw_rad=place.yaw_rad, without=("bottom", "top"))
    foot = (size[0] + 0.04, size[1] + 0.04, float(rng.uniform(1.0, 1.4)))
    return shaft + box(place.base_m, foot, "hazard", yaw_rad=place.yaw_rad)
