"""The lights of a world on one visit: lamps, windows, sun and sky.

A light is a number of points or directions from which it comes, so that shadows have soft edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from covinz.types import Array
from covinz_agents.world.builders import level
from covinz_agents.world.geometry import Face, World

# Points from which the light of all lamps and windows comes.
_POINTS = 48
# Light falls from so many directions of the sky, and of the sun's blurred disc.
_SKY_DIRECTIONS, _SUN_DIRECTIONS = 40, 6
_SUN_BLUR = 0.012
# Emitters sit this far before their faces. [m]
_BEFORE_M = 0.04
# Lamps of a hall that has none of its own. [m]
_GRID_M, _BELOW_ROOF_M = 5.0, 1.2
# Colours by hue from cold to warm, BGR.
_COLD, _WARM = np.array([1.10, 1.0, 0.90]), np.array([0.68, 0.92, 1.12])


@dataclass(frozen=True, slots=True, eq=False)
class PointLights:
    """Small emitters that shine before them, by Lambert's law.

    Attributes:
        position_m: (N, 3)
        normal: (N, 3) unit direction in which they shine.
        colour: (N, 3) BGR intensity along it.
    """

    position_m: Array
    normal: Array
    colour: Array


@dataclass(frozen=True, slots=True, eq=False)
class FarLights:
    """Light from afar.

    Attributes:
        towards: (N, 3) unit directions to the light.
        colour: (N, 3) BGR irradiance on a surface that faces it.
    """

    towards: Array
    colour: Array


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """All lights of a visit.

    Attributes:
        points: Lamps and windows.
        far: Sun and sky.
        emitted: (F, 3) BGR radiance of each face per albedo, relative to a well-lit surface; 0
            where a face only reflects.
        ambient: (3,) BGR share of the mean light that reaches every surface.
        sun: (3,) unit direction to the sun.
    """

    points: PointLights
    far: FarLights
    emitted: Array
    ambient: Array
    sun: Array


def lighting(world: World, light: int) -> Lighting:
    """The lights of a world; 0 is an ordinary day, every other number another light."""
    rng = np.random.default_rng([world.seed, light, 0x11])
    # The day and the lamps of light 0 are the middle of what others may be.
    daylight = 1.0 if light == 0 else float(np.exp(rng.uniform(-1.2, 0.7)))
    warmth = 0.4 if light == 0 else float(rng.uniform(0.0, 1.0))
    azimuth = 0.7 if light == 0 else float(rng.uniform(-np.pi, np.pi))
    elevation = 0.85 if light == 0 else float(rng.uniform(0.4, 1.1))
    sun = np.array([*(np.cos(elevation) * _circle(azimuth)), np.sin(elevation)])
    if world.outdoors:
        return _open_air(world, rng, sun, warmth, overcast=0.0 if light == 0 else rng.uniform())
    return _indoors(world, rng, sun, (daylight, warmth), 0.0 if light == 0 else 0.35)


def _circle(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle)])


def _tint(warmth: float) -> Array:
    tint: Array = (1 - warmth) * _COLD + warmth * _WARM
    return tint


def _indoors(
    world: World, rng: np.random.Generator, sun: Array, day: tuple[float, float], off_share: float
) -> Lighting:
    daylight, warmth = day
    emitted = np.zeros((len(world.faces), 3))
    sources: list[tuple[Face, Array]] = []
    for number, face in enumerate(world.faces):
        if face.material == "lamp" and rng.random() >= off_share:
            strength = 1.0 * _tint(warmth) * rng.uniform(0.85, 1.15)
            emitted[number] = 4.0 * _tint(warmth)
        elif face.material == "window":
            facing_sun = 0.5 + max(0.0, float(-face.normal @ sun))
            strength = 0.35 * daylight * facing_sun * _tint(0.2)
            emitted[number] = 1.6 * min(daylight * facing_sun, 1.5) * _tint(0.2)
        else:
            continue
        sources.append((face, strength))
    if not any(face.material == "lamp" for face, _ in sources):
        sources += [(face, _tint(warmth)) for face in _roof_grid(world)]
    return Lighting(
        _points(sources, rng),
        FarLights(np.empty((0, 3)), np.empty((0, 3))),
        emitted,
        np.full(3, 0.15),
        sun,
    )


def _roof_grid(world: World) -> list[Face]:
    """Lamps under the roof of a hall whose builder hung none."""
    low, high = world.low_m, world.high_m
    return [
        level((x, y, high[2] - _BELOW_ROOF_M), 0.0, 0.8, 0.8, "lamp", facing_up=False)
        for x in np.arange(low[0] + _GRID_M / 2, high[0], _GRID_M)
        for y in np.arange(low[1] + _GRID_M / 2, high[1], _GRID_M)
    ]


def _points(sources: list[tuple[Face, Array]], rng: np.random.Generator) -> PointLights:
    """Points on faces that shine, the same number on each."""
    each = max(1, _POINTS // max(1, len(sources)))
    positions, normals, colours = [], [], []
    for face, strength in sources:
        area = float(np.linalg.norm(np.cross(face.u_m, face.v_m)))
        for s, t in _spread(each, rng):
            positions.append(face.corner_m + s * face.u_m + t * face.v_m + _BEFORE_M * face.normal)
            normals.append(face.normal)
            colours.append(strength * np.sqrt(area) / each)
    return PointLights(
        np.reshape(positions, (-1, 3)), np.reshape(normals, (-1, 3)), np.reshape(colours, (-1, 3))
    )


def _spread(number: int, rng: np.random.Generator) -> Array:
    """(N, 2) points that cover the unit square evenly (a golden lattice, shifted)."""
    k = np.arange(number)
    lattice = np.stack([(k + 0.5) / number, k * 0.6180339887 + rng.uniform()], axis=1)
    return np.asarray(0.05 + 0.9 * (lattice % 1.0))


def _open_air(
    world: World, rng: np.random.Generator, sun: Array, warmth: float, overcast: float
) -> Lighting:
    share = _spread(_SKY_DIRECTIONS, rng)
    up = np.sqrt(share[:, 0])
    around = 2 * np.pi * share[:, 1]
    sky = np.stack(
        [np.sqrt(1 - up**2) * np.cos(around), np.sqrt(1 - up**2) * np.sin(around), up], 1
    )
    suns = sun + _SUN_BLUR * rng.normal(size=(_SUN_DIRECTIONS, 3))
    suns /= np.linalg.norm(suns, axis=1, keepdims=True)
    sun_colour = (1.0 - 0.85 * overcast) * _tint(0.4 + 0.5 * warmth)
    # Directions are drawn by the cosine law for level ground: divided by it, they weigh the same.
    sky_colour = (0.45 + 0.35 * overcast) * np.array([1.12, 1.0, 0.9])
    weights = sky_colour / (len(sky) * np.maximum(up, 0.2))[:, None]
    far = FarLights(
        np.concatenate([suns, sky]),
        np.concatenate([np.tile(sun_colour / len(suns), (len(suns), 1)), weights]),
    )
    none = PointLights(*(np.empty((0, 3)) for _ in range(3)))
    return Lighting(none, far, np.zeros((len(world.faces), 3)), np.full(3, 0.16), sun)
