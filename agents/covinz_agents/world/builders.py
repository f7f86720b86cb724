"""Shapes that worlds are built of, as textured faces; z is up."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from covinz.types import Array
from covinz_agents.world.geometry import Face

UP = np.array([0.0, 0.0, 1.0])
# Sides of a box in its own axes; `back` and `bottom` are often hidden and then left out.
SIDES = ("front", "right", "back", "left", "top", "bottom")


def heading(yaw_rad: float) -> Array:
    """(3,) horizontal unit vector at an angle from x."""
    return np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0])


def upright(
    center_m: ArrayLike, normal: ArrayLike, width_m: float, height_m: float, material: str
) -> Face:
    """A vertical face around its centre, read by whoever looks against the horizontal normal."""
    outward = np.asarray(normal, dtype=float)
    u = np.cross(UP, outward / np.linalg.norm(outward)) * width_m
    v = -UP * height_m
    return Face(np.asarray(center_m, dtype=float) - (u + v) / 2, u, v, material)


def level(
    center_m: ArrayLike,
    yaw_rad: float,
    length_m: float,
    width_m: float,
    material: str,
    *,
    facing_up: bool = True,
) -> Face:
    """A horizontal face around its centre: a floor, or a ceiling if it faces down."""
    u = heading(yaw_rad) * length_m
    v = heading(yaw_rad + (-np.pi / 2 if facing_up else np.pi / 2)) * width_m
    return Face(np.asarray(center_m, dtype=float) - (u + v) / 2, u, v, material)


def box(
    base_m: ArrayLike,
    size_m: Sequence[float],
    material: str | Mapping[str, str],
    *,
    yaw_rad: float = 0.0,
    without: Sequence[str] = ("bottom",),
) -> list[Face]:
    """A box that stands on a point.

    Args:
        base_m: (3,) centre of its bottom.
        size_m: Length along its own x, width along y, height.
        material: Of all sides, or of each by name (see `SIDES`; `other` for those not named).
            The front looks along its own -y, the right side along +x.
        yaw_rad: Turn of its x axis about the vertical.
        without: Sides to leave out.
    """
    length, width, height = size_m
    base = np.asarray(base_m, dtype=float)
    x, y = heading(yaw_rad), heading(yaw_rad + np.pi / 2)
    middle = base + UP * height / 2
    named: Mapping[str, str] = {"other": material} if isinstance(material, str) else material

    def of(side: str) -> str:
        return named[side] if side in named else named["other"]

    top = base + UP * height
    sides = {
        "front": (middle - y * width / 2, -y, length),
        "right": (middle + x * length / 2, x, width),
        "back": (middle + y * width / 2, y, length),
        "left": (middle - x * length / 2, -x, width),
    }
    faces = {side: upright(at, n, w, height, of(side)) for side, (at, n, w) in sides.items()}
    faces["top"] = level(top, yaw_rad, length, width, of("top"))
    faces["bottom"] = level(base, yaw_rad, length, width, of("bottom"), facing_up=False)
    return [face for side, face in faces.items() if side not in without]


def column(
    base_m: ArrayLike, radius_m: float, height_m: float, material: str, *, sides: int = 8
) -> list[Face]:
    """The sides of an upright prism: a round pillar or tank; its ends are left open."""
    middle = np.asarray(base_m, dtype=float) + UP * height_m / 2
    inner = radius_m * np.cos(np.pi / sides)
    width = 2 * radius_m * np.sin(np.pi / sides)
    outward = [heading(2 * np.pi * (k + 0.5) / sides) for k in range(sides)]
    return [upright(middle + inner * n, n, width, height_m, material) for n in outward]


def lid(
    center_m: ArrayLike, radius_m: float, material: str, *, sides: int = 8, facing_up: bool = True
) -> list[Face]:
    """The end of a `column` with an even number of sides.

    Source: a regular polygon with an even number of sides is tiled by one parallelogram for
    each pair of its directions.
    """
    corners = [radius_m * heading(2 * np.pi * k / sides) for k in range(sides // 2 + 1)]
    edges = np.diff(corners, axis=0)
    start = np.asarray(center_m, dtype=float) + corners[0]
    faces = []
    for i, j in itertools.combinations(range(len(edges)), 2):
        u, v = (edges[j], edges[i]) if facing_up else (edges[i], edges[j])
        faces.append(Face(start + edges[i + 1 : j].sum(axis=0), u, v, material))
    return faces


def pipe(
    from_m: ArrayLike, to_m: ArrayLike, radius_m: float, material: str, *, sides: int = 6
) -> list[Face]:
    """The sides of a prism between two points; its ends are left open."""
    start = np.asarray(from_m, dtype=float)
    along = np.asarray(to_m, dtype=float) - start
    axis = along / np.linalg.norm(along)
    across = np.cross(axis, UP if abs(axis[2]) < 0.9 else heading(0.0))
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    inner = radius_m * np.cos(np.pi / sides)
    width = 2 * radius_m * np.sin(np.pi / sides)
    faces = []
    for k in range(sides):
        angle = 2 * np.pi * (k + 0.5) / sides
        normal = np.cos(angle) * across + np.sin(angle) * other
        v = np.cross(along, normal)
        v *= width / np.linalg.norm(v)
        faces.append(Face(start + inner * normal - v / 2, along, v, material))
    return faces


def tiles(face: Face, longest_m: float) -> list[Face]:
    """A large face cut into a grid of faces no longer than that, each with its own texture."""
    across = max(1, int(np.ceil(np.linalg.norm(face.u_m) / longest_m)))
    down = max(1, int(np.ceil(np.linalg.norm(face.v_m) / longest_m)))
    u, v = face.u_m / across, face.v_m / down
    return [
        Face(face.corner_m + i * u + j * v, u, v, face.material)
        for j in range(down)
        for i in range(across)
    ]
