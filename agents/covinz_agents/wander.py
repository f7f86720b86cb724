"""A seeded walk through the free space of a world: smooth, with room to turn, never in a corner.

The walk is planned in the plane: arcs of bounded curvature whose ends lie in cells that are free
over the whole band of heights, chosen so that they lead to one random place after another.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz.types import Array

# Distance (N,) [m] from points (N, 3) [m] to the nearest surface.
Clearance = Callable[[Array], Array]

# Tightest turn of the walk. [m]
TURN_RADIUS_M = 1.5
# Length of an arc, and the curvatures tried, as shares of the tightest.
ARC_M = 0.5
_CURVATURES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0]) / TURN_RADIUS_M
# The way to a goal is looked up so far ahead of an arc's end. [m]
_LOOK_AHEAD_M = 1.0
# Random part of the choice among arcs, and what a change of curvature costs. [m of way]
_WHIM_M = 0.15
_CHANGE_M = 0.3
# A goal is reached from this near, ... [m]
_ARRIVED_M = 2.0
# ... and given up after so many times its distance.
_PATIENCE = 3.0
# Cells of the plan: this size, or so many along the longer side of a large world.
_CELL_M, _MAX_CELLS = 0.4, 120
# The walk gives up after so many arcs tried for each that it needs.
_TRIES_PER_ARC = 40
# A dead end is left backwards by up to so many arcs.
_MAX_RETREAT = 8


class NoFreePath(ValueError):
    """The world has no path of the length and clearance asked for."""


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpace:
    """Where a robot may be, seen from above.

    Attributes:
        low_m: (2,) lower corner of the first cell.
        cell_m: Side of a cell.
        free: (nx, ny) bool: far enough from everything, at all heights; one connected part.
    """

    low_m: Array
    cell_m: float
    free: NDArray[np.bool_]

    def cell(self, points_m: Array) -> NDArray[np.intp]:
        """Cells (..., 2) of points (..., 2), clipped to the grid."""
        index = np.floor((points_m - self.low_m) / self.cell_m).astype(np.intp)
        return np.clip(index, 0, np.array(self.free.shape) - 1)

    def is_free(self, points_m: Array) -> NDArray[np.bool_]:
        """Whether points (..., 2) lie in free cells."""
        cell = self.cell(points_m)
        beyond = np.abs(points_m - self.center(cell)).max(axis=-1) > self.cell_m
        found: NDArray[np.bool_] = self.free[cell[..., 0], cell[..., 1]] & ~beyond
        return found

    def center(self, cell: NDArray[np.intp]) -> Array:
        """Middles (..., 2) of cells (..., 2)."""
        middle: Array = self.low_m + (cell + 0.5) * self.cell_m
        return middle


def free_space(
    clearance: Clearance,
    low_m: Array,
    high_m: Array,
    height_m: tuple[float, float],
    margin_m: float,
) -> FreeSpace:
    """The largest connected part of a world's free space.

    Args:
        clearance: Distance to the nearest surface.
        low_m: (3,) lower corner of where robots may be.
        high_m: (3,) upper corner.
        height_m: Lowest and highest of the band that must be free.
        margin_m: Clearance asked for.

    Raises:
        NoFreePath: If nothing is free.
    """
    extent = high_m[:2] - low_m[:2]
    cell_m = max(_CELL_M, float(extent.max()) / _MAX_CELLS)
    shape = np.maximum(1, np.ceil(extent / cell_m).astype(int))
    axes = [low_m[i] + (np.arange(shape[i]) + 0.5) * cell_m for i in range(2)]
    x, y = np.meshgrid(*axes, indexing="ij")
    nearest = np.full(x.shape, np.inf)
    levels = max(2, 1 + round((height_m[1] - height_m[0]) / max(cell_m, 0.5)))
    for z in np.linspace(*height_m, levels):
        points = np.stack([x, y, np.full_like(x, z)], axis=-1).reshape(-1, 3)
        nearest = np.minimum(nearest, clearance(points).reshape(x.shape))
    free = _largest_part(nearest >= margin_m)
    if not free.any():
        raise NoFreePath(f"nowhere in this world is {margin_m:g} m of free space")
    return FreeSpace(np.asarray(low_m[:2], dtype=float), cell_m, free)


def wander(space: FreeSpace, length_m: float, rng: np.random.Generator) -> Array | None:
    """Points (N, 2) of a walk, `ARC_M` apart; None where it began without room to turn.

    Depth first: a dead end is left backwards.
    """
    count = 1 + int(np.ceil(length_m / ARC_M))
    cells = np.argwhere(space.free)
    start = np.append(space.center(cells[rng.integers(len(cells))]), rng.uniform(-np.pi, np.pi))
    goal = _Goal(space, rng, start)
    walk = [_Step(start, 0.0, goal.options(start, 0.0))]
    for _ in range(_TRIES_PER_ARC * count):
        if not walk:
            break
        if len(walk) == count:
            return np.array([step.pose[:2] for step in walk])
        here = walk[-1]
        if not here.options:
            del walk[-int(rng.integers(1, _MAX_RETREAT)) :]
            continue
        curvature, pose = here.options.pop()
        if space.is_free(pose[:2]):
            goal.renew(pose)
            walk.append(_Step(pose, curvature, goal.options(pose, curvature)))
    return None


@dataclass(slots=True, eq=False)
class _Step:
    """A pose (x, y, heading) on the walk, how it was reached, and arcs not yet tried, best last."""

    pose: Array
    curvature: float
    options: list[tuple[float, Array]]


class _Goal:
    """One random place after another, and which arcs lead there."""

    def __init__(self, space: FreeSpace, rng: np.random.Generator, pose: Array) -> None:
        self._space, self._rng = space, rng
        self._cells = np.argwhere(space.free)
        self._choose(pose)

    def renew(self, pose: Array) -> None:
        """Choose another goal when this one is reached, or takes too long."""
        self._budget_m -= ARC_M
        if self._way(pose[:2]) < _ARRIVED_M or self._budget_m < 0:
            self._choose(pose)

    def options(self, pose: Array, curvature: float) -> list[tuple[float, Array]]:
        """Curvatures and ends of the arcs from a pose, the best last."""
        ends = np.stack([_advance(pose, c) for c in _CURVATURES])
        ahead = ends[:, :2] + _LOOK_AHEAD_M * np.stack(
            [np.cos(ends[:, 2]), np.sin(ends[:, 2])], axis=1
        )
        cost = self._way(ahead) + _WHIM_M * self._rng.normal(size=len(ends))
        cost += _CHANGE_M * TURN_RADIUS_M * np.abs(_CURVATURES - curvature)
        return [(float(_CURVATURES[i]), ends[i]) for i in np.argsort(-cost, kind="stable")]

    def _choose(self, pose: Array) -> None:
        goal = self._cells[self._rng.integers(len(self._cells))]
        self._way_m = _ways(self._space, goal)
        self._budget_m = _PATIENCE * float(self._way(pose[:2])) + 2 * np.pi * TURN_RADIUS_M

    def _way(self, points_m: Array) -> Array:
        cell = self._space.cell(points_m)
        way: Array = self._way_m[cell[..., 0], cell[..., 1]]
        return way


def _advance(pose: Array, curvature: float) -> Array:
    """End (x, y, heading) of an arc."""
    turn = curvature * ARC_M
    # Chord of the arc, in the direction of its middle.
    chord = ARC_M * np.sinc(turn / (2 * np.pi))
    middle = pose[2] + turn / 2
    x, y = pose[:2] + chord * np.array([np.cos(middle), np.sin(middle)])
    return np.array([x, y, pose[2] + turn])


def _ways(space: FreeSpace, goal: NDArray[np.intp]) -> Array:
    """Length [m] of the way (nx, ny) from every cell to one; cells that are not free are far."""
    far = 10.0 * space.cell_m * sum(space.free.shape)
    way = np.full(space.free.shape, far)
    way[tuple(goal)] = 0.0
    queue = [(0.0, int(goal[0]), int(goal[1]))]
    steps = [
        (i, j, space.cell_m * np.hypot(i, j)) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j
    ]
    nx, ny = space.free.shape
    while queue:
        here, x, y = heapq.heappop(queue)
        if here > way[x, y]:
            continue
        for i, j, step_m in steps:
            to = (x + i, y + j)
            if 0 <= to[0] < nx and 0 <= to[1] < ny and space.free[to] and here + step_m < way[to]:
                way[to] = here + step_m
                heapq.heappush(queue, (here + step_m, *to))
    return way


def _largest_part(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest 4-connected part of a mask (nx, ny)."""
    label = np.zeros(free.shape, dtype=int)
    for number, seed in enumerate(np.argwhere(free), start=1):
        if label[tuple(seed)]:
            continue
        stack = [tuple(seed.tolist())]
        while stack:
            x, y = stack.pop()
            inside = 0 <= x < free.shape[0] and 0 <= y < free.shape[1]
            if inside and free[x, y] and not label[x, y]:
                label[x, y] = number
                stack += [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]
    sizes = np.bincount(label.ravel())
    sizes[0] = 0
    largest: NDArray[np.bool_] = free & (label == sizes.argmax())
    return largest
