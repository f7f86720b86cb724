"""Light on all surfaces of a world, with shadows and one bounce, computed once per visit's light.

Source: Keller, "Instant radiosity", SIGGRAPH 1997, for the bounce: surfaces that are lit light
others as small lamps do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from covinz.types import Array
from covinz_agents.world.geometry import World
from covinz_agents.world.lights import Lighting, PointLights
from covinz_agents.world.shadows import ShadowMaps

# Light is computed on a grid of about this many points in all, no finer and no coarser than
# these distances. [m]
_POINTS = 130_000
_FINEST_M, _COARSEST_M = 0.1, 1.0
# Light of a surface is computed this far before it. [m]
_BEFORE_M = 0.05
# Surfaces that pass light on: number, mean albedo, and the distance below which their light no
# longer grows (points that stand for surfaces have no near field). [m]
_BOUNCES, _ALBEDO, _SOFT_M = 40, 0.4, 1.2


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Where light is computed.

    Attributes:
        at_m: (N, 3)
        normal: (N, 3)
        sizes: Of each face, the rows and columns of its grid.
    """

    at_m: Array
    normal: Array
    sizes: tuple[tuple[int, int], ...]


def bake(world: World, lights: Lighting) -> Array:
    """Irradiance (N, 3) BGR on the grids of all faces one after the other (see `grid_sizes`).

    1 is a well-lit surface.

    Raises:
        RenderError: If there is no EGL.
    """
    samples = _samples(world)
    with ShadowMaps(world) as shadows:
        light = _from_points(lights.points, samples.at_m, samples.normal, shadows, 0.1)
        for towards, colour in zip(lights.far.towards, lights.far.colour, strict=True):
            cosine = np.maximum(samples.normal @ towards, 0)
            lit = np.flatnonzero(cosine)
            seen = lit[shadows.seen_from_afar(towards, samples.at_m[lit])]
            light[seen] += cosine[seen, None] * colour
        if len(lights.points.position_m):
            light += _bounced(world, samples, light, shadows)
    # Light that was reflected more often comes from everywhere, a little more from above.
    ambient = lights.ambient * np.mean(light, axis=0)
    light += ambient * (1 + 0.35 * samples.normal[:, 2:])
    light /= np.quantile(light.mean(axis=1)[::7], 0.95)
    return light


def grid_sizes(world: World) -> list[tuple[int, int]]:
    """Rows and columns of the grid on which the light of each face is known."""
    sides = [(np.linalg.norm(face.v_m), np.linalg.norm(face.u_m)) for face in world.faces]
    area = sum(float(high * wide) for high, wide in sides)
    spacing = float(np.clip(np.sqrt(area / _POINTS), _FINEST_M, _COARSEST_M))
    return [
        (max(2, round(float(high) / spacing)), max(2, round(float(wide) / spacing)))
        for high, wide in sides
    ]


def _samples(world: World) -> _Samples:
    positions, normals, sizes = [], [], grid_sizes(world)
    for face, (rows, columns) in zip(world.faces, sizes, strict=True):
        t, s = np.meshgrid(
            (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij"
        )
        at = face.corner_m + s[..., None] * face.u_m + t[..., None] * face.v_m
        positions.append((at + _BEFORE_M * face.normal).reshape(-1, 3))
        normals.append(np.tile(face.normal, (rows * columns, 1)))
    return _Samples(np.concatenate(positions), np.concatenate(normals), tuple(sizes))


def _from_points(
    lights: PointLights, at_m: Array, normal: Array, shadows: ShadowMaps, soft_m: float
) -> Array:
    """(N, 3) irradiance from small emitters."""
    light = np.zeros((len(at_m), 3))
    for point, shines, colour in zip(lights.position_m, lights.normal, lights.colour, strict=True):
        towards = point - at_m
        squared = np.einsum("ni,ni->n", towards, towards)
        falls = np.einsum("ni,ni->n", normal, towards)
        leaves = -towards @ shines
        lit = np.flatnonzero((falls > 0) & (leaves > 0))
        lit = lit[shadows.seen_from_point(point, shines, at_m[lit])]
        share = falls[lit] * leaves[lit] / (squared[lit] * (squared[lit] + soft_m**2))
        light[lit] += share[:, None] * colour
    return light


def _bounced(world: World, samples: _Samples, light: Array, shadows: ShadowMaps) -> Array:
    """(N, 3) light that comes from lit surfaces: from some of them, for all."""
    rng = np.random.default_rng([world.seed, 0x22])
    chosen = rng.choice(len(samples.at_m), _BOUNCES, replace=False)
    sizes = [rows * columns for rows, columns in samples.sizes]
    areas = [float(np.linalg.norm(np.cross(face.u_m, face.v_m))) for face in world.faces]
    area_each = sum(areas) / sum(sizes) * len(samples.at_m) / _BOUNCES
    strength = _ALBEDO / np.pi * area_each * light[chosen]
    emitters = PointLights(samples.at_m[chosen], samples.normal[chosen], strength)
    return _from_points(emitters, samples.at_m, samples.normal, shadows, _SOFT_M)
