"""The plan of a world: outlines of what stands in it, as seen from above."""

from __future__ import annotations

import numpy as np

from covinz.types import Array
from covinz_agents.world.geometry import Face, World

# Faces lower or higher above the world's lowest point than this are floor, marks on it, roofs and
# what hangs from them. [m]
_LOWEST_M, _HIGHEST_M = 0.3, 4.0
_FLAT = 0.2


def plan(world: World) -> list[Array]:
    """Polygons (K, 2), in metres, of everything that stands in a world, in its frame.

    A horizontal face gives its outline; an upright one the line of its foot, as a polygon of
    two points.
    """
    outlines = [_corners(face) for face in world.faces]
    floor_m = min((corners[:, 2].min() for corners in outlines), default=0.0)
    polygons: list[Array] = []
    for face, corners in zip(world.faces, outlines, strict=True):
        if not _stands(corners[:, 2] - floor_m):
            continue
        if abs(face.normal[2]) > _FLAT:
            polygons.append(corners[:, :2])
        else:
            polygons.append(_foot(face))
    return polygons


def _corners(face: Face) -> Array:
    """(4, 3) corners in order around the face."""
    offsets = [np.zeros(3), face.u_m, face.u_m + face.v_m, face.v_m]
    return np.array([face.corner_m + offset for offset in offsets])


def _stands(heights_m: Array) -> bool:
    return bool(heights_m.max() > _LOWEST_M and heights_m.min() < _HIGHEST_M)


def _foot(face: Face) -> Array:
    """(2, 2) the horizontal extent of an upright face."""
    corners = _corners(face)[:, :2]
    along = np.array([-face.normal[1], face.normal[0]])
    at = corners @ along
    return corners[[int(at.argmin()), int(at.argmax())]]
