"""Distances in a world: to its nearest face, and along rays to what they hit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from covinz.types import Array
from covinz_agents.world.geometry import World

# Points or rays handled at once, so that (points, faces, 3) arrays stay small.
_CHUNK = 512


def clearance_m(world: World, points_m: ArrayLike) -> Array:
    """Distances (N,) in metres of points (N, 3) to the nearest face, from either side."""
    points = np.reshape(np.asarray(points_m, dtype=float), (-1, 3))
    corner, u, v = _faces(world)
    nearest = np.empty(len(points))
    for start in range(0, len(points), _CHUNK):
        chunk = points[start : start + _CHUNK]
        nearest[start : start + _CHUNK] = _squared_distance(chunk, corner, u, v).min(axis=1)
    return np.sqrt(nearest)


def first_hit_m(world: World, origins_m: ArrayLike, directions: ArrayLike) -> Array:
    """Distances (N,) in metres from origins (N, 3) along unit directions (N, 3) to what is seen.

    Faces seen from behind are transparent, as in the renderer; inf where nothing is hit.
    """
    origins, rays = np.broadcast_arrays(
        np.reshape(np.asarray(origins_m, dtype=float), (-1, 3)),
        np.reshape(np.asarray(directions, dtype=float), (-1, 3)),
    )
    corner, u, v = _faces(world)
    normal = np.cross(v, u)
    # Rows of the inverse of [u v n]: coordinates of a point in its face.
    to_face = np.linalg.inv(np.stack([u, v, normal], axis=-1))
    hit = np.empty(len(origins))
    for start in range(0, len(origins), _CHUNK):
        end = start + _CHUNK
        offset = origins[start:end, None] - corner
        begin = np.einsum("fij,nfj->nfi", to_face, offset)
        step = np.einsum("fij,nj->nfi", to_face, rays[start:end])
        towards = step[..., 2] < -1e-12
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(towards, -begin[..., 2] / step[..., 2], np.inf)
            at = begin[..., :2] + distance[..., None] * step[..., :2]
        inside = towards & (distance >= 0) & (at >= 0).all(axis=-1) & (at <= 1).all(axis=-1)
        hit[start:end] = np.where(inside, distance, np.inf).min(axis=1, initial=np.inf)
    return hit


def _faces(world: World) -> tuple[Array, Array, Array]:
    """Corners and sides (F, 3) of all faces."""
    corner, u, v = (
        np.array([getattr(face, name) for face in world.faces]).reshape(-1, 3)
        for name in ("corner_m", "u_m", "v_m")
    )
    return corner, u, v


def _squared_distance(points: Array, corner: Array, u: Array, v: Array) -> Array:
    """(N, F) squared distances of points to parallelograms."""
    offset = points[:, None] - corner
    uu, vv, uv = ((a * b).sum(axis=1) for a, b in ((u, u), (v, v), (u, v)))
    along_u, along_v = np.einsum("nfi,fi->nf", offset, u), np.einsum("nfi,fi->nf", offset, v)
    det = uu * vv - uv * uv
    s = (vv * along_u - uv * along_v) / det
    t = (uu * along_v - uv * along_u) / det
    # The nearest point is the foot of the perpendicular or lies on one of the four sides.
    inside = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    best = np.where(inside, _squared(offset, s, t, u, v), np.inf)
    for side in (0.0, 1.0):
        at = np.clip((along_u - side * uv) / uu, 0, 1)
        best = np.minimum(best, _squared(offset, at, np.full_like(at, side), u, v))
        at = np.clip((along_v - side * uv) / vv, 0, 1)
        best = np.minimum(best, _squared(offset, np.full_like(at, side), at, u, v))
    return best


def _squared(offset: Array, s: Array, t: Array, u: Array, v: Array) -> Array:
    """(N, F) squared distances of points to the points (s, t) of their faces."""
    rest = offset - s[..., None] * u - t[..., None] * v
    squared: Array = np.einsum("nfi,nfi->nf", rest, rest)
    return squared
