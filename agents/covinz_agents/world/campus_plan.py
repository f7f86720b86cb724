"""The plan of the campus, which depends on its size alone, so that paths can be given in advance.

A grid of streets, four along y and three along x, all `STREET_M` wide from front to front, around
three by two blocks::

    houses   court (open to -y)   yard
    court    park                 alley along y
    (open to +x)
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from covinz.scenario import CourtyardScene
from covinz.types import Array

# From front to front; the carriageway, and the lane along its middle in which nothing stands. [m]
STREET_M = 16.0
CARRIAGEWAY_M = 9.6
LANE_M = 4.8
# Of the lane through a court, the park and the alley. [m]
PATH_M = 4.0
KERB_M = 0.12
# Wings of the houses around a court, and the gap between those beside the alley. [m]
WING_M, ALLEY_M = 8.0, 9.0
_SMALLEST_BLOCK_M = 28.0


@dataclass(frozen=True, slots=True)
class Block:
    """What lies between four streets: corners (x, y) of the fronts around it [m]."""

    low_m: tuple[float, float]
    high_m: tuple[float, float]

    @property
    def middle_m(self) -> tuple[float, float]:
        """(x, y) of its centre."""
        return (self.low_m[0] + self.high_m[0]) / 2, (self.low_m[1] + self.high_m[1]) / 2


def street_lines_m(scene: CourtyardScene) -> tuple[list[float], list[float]]:
    """Middles of the four streets along y (their x) and of the three along x (their y).

    Raises:
        ValueError: If the scene is too small.
    """
    lines = []
    for size_m, number in zip(scene.size_m, (4, 3), strict=True):
        block_m = (size_m - number * STREET_M) / (number - 1)
        if block_m < _SMALLEST_BLOCK_M:
            needed_m = number * STREET_M + (number - 1) * _SMALLEST_BLOCK_M
            raise ValueError(f"a courtyard needs {needed_m:.0f} m that way, not {size_m:g}")
        first_m = (STREET_M - size_m) / 2
        lines.append([first_m + i * (block_m + STREET_M) for i in range(number)])
    return lines[0], lines[1]


def blocks(scene: CourtyardScene) -> list[Block]:
    """The six blocks, row by row from the lowest x and y."""
    xs, ys = street_lines_m(scene)
    half = STREET_M / 2
    return [
        Block((x0 + half, y0 + half), (x1 - half, y1 - half))
        for y0, y1 in itertools.pairwise(ys)
        for x0, x1 in itertools.pairwise(xs)
    ]


def lanes_m(scene: CourtyardScene) -> list[tuple[Array, Array, float]]:
    """Where one can walk: (start (2,), end (2,), width) of the streets and the ways off them."""
    xs, ys = street_lines_m(scene)
    plan = blocks(scene)
    west, park, alley, south = plan[0], plan[1], plan[2], plan[4]
    ways = [((x, ys[0]), (x, ys[-1]), LANE_M) for x in xs]
    ways += [((xs[0], y), (xs[-1], y), LANE_M) for y in ys]
    inner = WING_M + PATH_M
    ways += [
        ((west.low_m[0] + inner, west.middle_m[1]), (xs[1], west.middle_m[1]), PATH_M),
        ((xs[1], park.middle_m[1]), (xs[2], park.middle_m[1]), PATH_M),
        ((alley.middle_m[0], ys[0]), (alley.middle_m[0], ys[1]), PATH_M),
        ((south.middle_m[0], ys[1]), (south.middle_m[0], south.high_m[1] - inner), PATH_M),
    ]
    return [(np.array(start), np.array(end), width) for start, end, width in ways]


def off_lanes_m(scene: CourtyardScene, place_m: Array) -> float:
    """Distance of a place (2,) from the edge of the nearest lane; negative on a lane."""
    distances = []
    for start, end, width_m in lanes_m(scene):
        along = end - start
        share = np.clip((place_m - start) @ along / (along @ along), 0, 1)
        distances.append(float(np.linalg.norm(place_m - start - share * along)) - width_m / 2)
    return min(distances)


def kerb_lines_m(scene: CourtyardScene) -> list[tuple[Array, Array]]:
    """Both edges of the carriageway between crossings: start and end, the street to the left."""
    xs, ys = street_lines_m(scene)
    nodes = [((x, y0), (x, y1)) for x in xs for y0, y1 in itertools.pairwise(ys)]
    nodes += [((x0, y), (x1, y)) for y in ys for x0, x1 in itertools.pairwise(xs)]
    sides = []
    for ends in nodes:
        start, end = np.array(ends)
        along = (end - start) / np.linalg.norm(end - start)
        right = CARRIAGEWAY_M / 2 * np.array([along[1], -along[0]])
        corner = STREET_M / 2 * along
        sides += [(start + corner + right, end - corner + right),
                  (end - corner - right, start + corner - right)]  # fmt: skip
    return sides
