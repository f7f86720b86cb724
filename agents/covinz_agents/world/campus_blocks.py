"""What fills the blocks of the campus: houses, courts, a park, an alley, a yard."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from covinz.types import Array
from covinz_agents.world import facades, street
from covinz_agents.world.builders import level, tiles, upright
from covinz_agents.world.campus_plan import (
    ALLEY_M,
    CARRIAGEWAY_M,
    KERB_M,
    PATH_M,
    STREET_M,
    WING_M,
    Block,
)
from covinz_agents.world.geometry import Face

# A texture of the ground covers no more than this. [m]
TILE_M = 13.0


def raised(low: tuple[float, float], high: tuple[float, float]) -> list[Face]:
    """Pavement above the street, with its kerb."""
    (x0, y0), (x1, y1) = low, high
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    kerbs = [_kerb(np.array(a), np.array(b)) for a, b in itertools.pairwise(corners)]
    return tiles(flat(low, high, KERB_M, "paving"), TILE_M) + kerbs


def _kerb(start: Array, end: Array) -> Face:
    """The side of a raised pavement, which looks to the right of the way from start to end."""
    along = end - start
    normal = np.array([along[1], -along[0], 0.0])
    center = np.append((start + end) / 2, KERB_M / 2)
    return upright(center, normal, float(np.linalg.norm(along)), KERB_M, "kerb")


def flat(low: Sequence[float], high: Sequence[float], z_m: float, material: str) -> Face:
    """A horizontal rectangle between two corners (x, y) that looks up."""
    middle = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, z_m)
    return level(middle, 0.0, high[0] - low[0], high[1] - low[1], material)


def pavement(block: Block) -> list[Face]:
    """Pavement around a block, and up to its middle where there are no houses."""
    out = (STREET_M - CARRIAGEWAY_M) / 2
    low, high = np.array(block.low_m) - out, np.array(block.high_m) + out
    return raised((low[0], low[1]), (high[0], high[1]))


def _rectangle(low: tuple[float, float], high: tuple[float, float]) -> list[tuple[float, float]]:
    """Corners, counter-clockwise."""
    return [low, (high[0], low[1]), high, (low[0], high[1])]


def _houses(block: Block, rng: np.random.Generator) -> list[Face]:
    return facades.outline(_rectangle(block.low_m, block.high_m), rng)


def _court_east(block: Block, rng: np.random.Generator) -> list[Face]:
    """Houses around a court that is open to +x."""
    (x0, y0), (x1, y1) = block.low_m, block.high_m
    inner = x0 + WING_M
    corners = [(x0, y0), (x1, y0), (x1, y0 + WING_M), (inner, y0 + WING_M),
               (inner, y1 - WING_M), (x1, y1 - WING_M), (x1, y1), (x0, y1)]  # fmt: skip
    return facades.outline(corners, rng) + _about(
        (inner + 1.5, y0 + WING_M + 1.6), (x1 - 1, y1 - WING_M - 1.6), rng, 0
    )


def _court_south(block: Block, rng: np.random.Generator) -> list[Face]:
    """Houses around a court that is open to -y."""
    (x0, y0), (x1, y1) = block.low_m, block.high_m
    inner = y1 - WING_M
    corners = [(x0, y0), (x0 + WING_M, y0), (x0 + WING_M, inner), (x1 - WING_M, inner),
               (x1 - WING_M, y0), (x1, y0), (x1, y1), (x0, y1)]  # fmt: skip
    return facades.outline(corners, rng) + _about(
        (x0 + WING_M + 1.6, y0 + 1), (x1 - WING_M - 1.6, inner - 1.5), rng, 1
    )


def _about(
    low: tuple[float, float], high: tuple[float, float], rng: np.random.Generator, axis: int
) -> list[Face]:
    """Things along the two sides of a way along an axis through a court."""
    faces: list[Face] = []
    for at_m in np.arange(low[axis] + 2.0, high[axis], 5.0):
        for side_m in (low[1 - axis], high[1 - axis]):
            place = (at_m, side_m) if axis == 0 else (side_m, at_m)
            yaw_rad = float(rng.choice([0.0, np.pi])) + axis * np.pi / 2
            faces += street.thing(np.array([*place, KERB_M]), yaw_rad, rng)
    return faces


def _park(block: Block, rng: np.random.Generator) -> list[Face]:
    """Lawns with trees on both sides of a way along x, behind hedges and walls."""
    (x0, y0), (x1, y1), (mx, my) = block.low_m, block.high_m, block.middle_m
    gap, z, faces = PATH_M / 2 + 1.0, KERB_M, list[Face]()
    for low_y, high_y in ((y0, my - gap), (my + gap, y1)):
        lawn = flat((x0 + 0.5, low_y), (x1 - 0.5, high_y), z + 0.02, "grass")
        faces += tiles(lawn, TILE_M)
        for x in (x0, x1):
            faces += street.hedge((x, low_y, z), (x, high_y, z), float(rng.uniform(0.9, 1.3)))
        for x in np.linspace(x0 + 4, x1 - 4, 4) + rng.uniform(-1, 1, 4):
            y = rng.uniform(low_y + 2.5, high_y - 2.5)
            place = np.array([x, y, z])
            faces += street.tree(place, rng) if rng.random() < 0.7 else street.shrub(place, rng)
    for side, y in ((-1, y0), (1, y1)):
        faces += street.garden_wall((x0, y, z), (mx - 3, y, z), 1.9)
        faces += street.hedge((mx + 1, y, z), (x1, y, z), 1.5)
        edge = my + side * (PATH_M / 2 + 0.6)
        for x in (x0 + 5, x1 - 7):
            faces += street.bench(np.array([x, edge, z]), 0.0 if side > 0 else np.pi)
        faces += street.notice(np.array([mx + side * 5, edge, z]), 0.0, rng)
    return faces + street.stall(np.array([mx, my + gap + 2.5, z]), 0.0, rng)


def _alley(block: Block, rng: np.random.Generator) -> list[Face]:
    """Two houses' depth on both sides of a narrow way along y."""
    (x0, y0), (x1, y1), (mx, _) = block.low_m, block.high_m, block.middle_m
    left = facades.outline(_rectangle((x0, y0), (mx - ALLEY_M / 2, y1)), rng)
    return left + facades.outline(_rectangle((mx + ALLEY_M / 2, y0), (x1, y1)), rng)


def _yard(block: Block, rng: np.random.Generator) -> list[Face]:
    """A workshop, vans in a row and walls on two sides."""
    (x0, y0), (x1, y1), z = block.low_m, block.high_m, KERB_M
    faces = facades.outline(_rectangle((x0 + 4, y1 - 15), (x1 - 8, y1 - 3)), rng)
    for x in np.arange(x0 + 3.0, x1 - 3.0, 4.2):
        if rng.random() < 0.75:
            faces += street.van(
                np.array([x, y0 + 6.0, z]), float(rng.choice([-1, 1])) * np.pi / 2, rng
            )
    faces += street.garden_wall((x1, y0 + 2, z), (x1, y1, z), 2.2)
    faces += street.garden_wall((x0, y1, z), (x1 - 10, y1, z), 2.0)
    faces += street.hedge((x0, y0, z), (x0, y1 - 8, z), 1.4)
    for y in (y0 + 1.0, y0 + 12.0):
        faces += street.tree(np.array([x1 - 3.0, y, z]), rng)
    return faces


FILLINGS: tuple[Callable[[Block, np.random.Generator], list[Face]], ...] = (
    _court_east, _park, _alley, _houses, _court_south, _yard,
)  # fmt: skip
