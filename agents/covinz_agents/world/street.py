"""What stands in streets and courts: trees, hedges, parked vans, lamps, benches, signs, stalls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from covinz.types import Array
from covinz_agents.world.builders import UP, box, column, heading, lid
from covinz_agents.world.geometry import Face


def tree(base_m: Array, rng: np.random.Generator) -> list[Face]:
    """A trunk and two clumps of leaves, 6 to 7 m high; it has no top, which nobody sees."""
    trunk_m = float(rng.uniform(2.2, 3.0))
    lean = np.append(rng.uniform(-0.4, 0.4, 2), 1.6)
    crown = base_m + trunk_m * UP
    faces = column(base_m, 0.22, trunk_m, "bark", sides=4)
    faces += lid(crown, 1.9, "foliage", sides=6, facing_up=False)
    faces += column(crown, 1.9, 2.0, "foliage", sides=6)
    return faces + column(crown + lean, 1.3, 2.2, "foliage", sides=6)


def shrub(base_m: Array, rng: np.random.Generator) -> list[Face]:
    """A bush about 1.4 m high."""
    height_m, radius_m = float(rng.uniform(1.0, 1.7)), float(rng.uniform(0.7, 1.1))
    top = lid(base_m + height_m * UP, radius_m, "foliage", sides=6)
    return column(base_m, radius_m, height_m, "foliage", sides=6) + top


def hedge(start_m: ArrayLike, end_m: ArrayLike, height_m: float) -> list[Face]:
    """A clipped hedge from start to end (x, y, z of the ground)."""
    return _row(start_m, end_m, (0.7, height_m), "hedge", "hedge")


def garden_wall(start_m: ArrayLike, end_m: ArrayLike, height_m: float) -> list[Face]:
    """A wall of bricks with coping stones."""
    return _row(start_m, end_m, (0.3, height_m), "garden_wall", "concrete")


def _row(
    start_m: ArrayLike, end_m: ArrayLike, size_m: tuple[float, float], side: str, top: str
) -> list[Face]:
    """A long box from start to end; size: width and height."""
    start, end = np.asarray(start_m, dtype=float), np.asarray(end_m, dtype=float)
    along = end - start
    size = (float(np.linalg.norm(along)), *size_m)
    yaw_rad = float(np.arctan2(along[1], along[0]))
    return box((start + end) / 2, size, {"top": top, "other": side}, yaw_rad=yaw_rad)


def van(base_m: Array, yaw_rad: float, rng: np.random.Generator) -> list[Face]:
    """A delivery van 4.9 m long whose nose points along `yaw_rad`; its wheels are painted on."""
    high_m, ahead = float(rng.uniform(1.7, 2.1)), heading(yaw_rad)
    low = base_m + 0.12 * UP
    body = {"right": "van_end", "left": "van_end", "front": "van_side", "back": "van_side",
            "other": "van_roof"}  # fmt: skip
    nose = {"right": "van_end", "other": "van_roof"}
    faces = box(low - 0.65 * ahead, (3.6, 1.9, high_m), body, yaw_rad=yaw_rad)
    faces += box(
        low + 1.8 * ahead, (1.3, 1.9, 1.05), nose, yaw_rad=yaw_rad, without=("bottom", "left")
    )
    screen = low + 1.17 * ahead + (high_m + 1.05) / 2 * UP
    left = heading(yaw_rad + np.pi / 2)
    rise = (high_m - 1.15) * UP
    corner = screen - 0.85 * left + rise / 2
    return [*faces, Face(corner, 1.7 * left, -rise, "windscreen")]


def lamp(base_m: Array) -> list[Face]:
    """A street lamp 4.5 m high."""
    head = {"bottom": "concrete", "other": "dark_metal"}
    post = column(base_m, 0.09, 4.2, "dark_metal", sides=4)
    return post + box(base_m + 4.2 * UP, (0.5, 0.5, 0.35), head, without=["top"])


def bench(base_m: Array, yaw_rad: float) -> list[Face]:
    """A bench 1.8 m long with a back."""
    behind = base_m + 0.25 * heading(yaw_rad + np.pi / 2)
    seat = box(base_m, (1.8, 0.5, 0.45), "wood", yaw_rad=yaw_rad, without=["bottom", "back"])
    return seat + box(behind, (1.8, 0.08, 0.9), "wood", yaw_rad=yaw_rad)


def notice(base_m: Array, yaw_rad: float, rng: np.random.Generator) -> list[Face]:
    """A board with text on both sides, down to the ground."""
    size = (float(rng.uniform(0.9, 1.4)), 0.15, float(rng.uniform(1.6, 2.2)))
    board = {"front": "sign", "back": "sign", "other": "dark_metal"}
    return box(base_m, size, board, yaw_rad=yaw_rad)


def stall(base_m: Array, yaw_rad: float, rng: np.random.Generator) -> list[Face]:
    """A kiosk: four painted walls, a shop window and a roof that juts out."""
    size = (float(rng.uniform(2.4, 3.4)), float(rng.uniform(2.0, 2.6)), 2.5)
    walls = {"front": "shop_front", "right": "sign", "other": "wood"}
    roof = (size[0] + 0.7, size[1] + 0.7, 0.3)
    kiosk = box(base_m, size, walls, yaw_rad=yaw_rad, without=["bottom", "top"])
    return kiosk + box(base_m + 2.5 * UP, roof, "awning", yaw_rad=yaw_rad, without=["top"])


def planter(base_m: Array, rng: np.random.Generator) -> list[Face]:
    """A tub with a clipped bush."""
    side_m, high_m = float(rng.uniform(0.9, 1.3)), float(rng.uniform(0.6, 1.0))
    bush = (side_m - 0.1, side_m - 0.1, high_m)
    tub = box(base_m, (side_m, side_m, 0.6), "concrete", without=["bottom", "top"])
    return tub + box(base_m + 0.55 * UP, bush, "hedge")


def thing(place: Array, yaw_rad: float, rng: np.random.Generator) -> list[Face]:
    """One of what stands about."""
    kind = rng.random()
    if kind < 0.25:
        return tree(place, rng)
    if kind < 0.45:
        return planter(place, rng)
    if kind < 0.6:
        return notice(place, yaw_rad + float(rng.choice([0, np.pi / 2])), rng)
    if kind < 0.7:
        return bench(place, yaw_rad + np.pi)
    if kind < 0.8:
        return lamp(place)
    return []
