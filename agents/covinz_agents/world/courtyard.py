"""A small campus under the sky: streets between houses, two courts, a park, an alley, a yard.

Its plan is that of `campus_plan`; houses stand around it all. The seed draws the houses, their
fronts, and what stands about.
"""

from __future__ import annotations

import itertools

import numpy as np

from covinz.scenario import CourtyardScene
from covinz.types import Array
from covinz_agents.world import facades, street
from covinz_agents.world.builders import tiles
from covinz_agents.world.campus_blocks import FILLINGS, flat, pavement, raised
from covinz_agents.world.campus_plan import (
    CARRIAGEWAY_M,
    KERB_M,
    STREET_M,
    blocks,
    kerb_lines_m,
    off_lanes_m,
    street_lines_m,
)
from covinz_agents.world.geometry import Face, World

# Half of the room that a thing by the kerb takes, and a van across; a tree's crown is higher. [m]
_ROOM_M, _VAN_ROOM_M = 1.2, 1.0


def courtyard(scene: CourtyardScene) -> World:
    """The campus; the same scene gives the same world.

    Raises:
        ValueError: If it is so small that nothing fits between its streets.
    """
    plan = blocks(scene)
    rng = np.random.default_rng([scene.seed, 2])
    half = np.array(scene.size_m) / 2
    faces = _ground(scene) + _outside(half, rng)
    for block, fill in zip(plan, FILLINGS, strict=True):
        faces += pavement(block) + fill(block, rng)
    for start, end in kerb_lines_m(scene):
        faces += _along_street(scene, start, end, rng)
    return World(
        tuple(faces), np.append(-half, 0.0), np.append(half, 4.0), outdoors=True, seed=scene.seed
    )


def _ground(scene: CourtyardScene) -> list[Face]:
    """Asphalt of the streets, and stripes where people cross."""
    xs, ys = street_lines_m(scene)
    half, wide = np.array(scene.size_m) / 2, STREET_M / 2
    strips = [flat((-half[0], y - wide), (half[0], y + wide), 0.0, "asphalt") for y in ys]
    for y0, y1 in itertools.pairwise(ys):
        strips += [flat((x - wide, y0 + wide), (x + wide, y1 - wide), 0.0, "asphalt") for x in xs]
    stripes = []
    for x, y in itertools.product(xs[1:-1], ys):
        edge, road = x + wide - 3.0, CARRIAGEWAY_M / 2
        stripes.append(flat((edge, y - road), (edge + 3.0, y + road), 0.02, "zebra"))
    return [piece for strip in strips for piece in tiles(strip, STREET_M)] + stripes


def _outside(half_m: Array, rng: np.random.Generator) -> list[Face]:
    """Houses around the campus, and the pavement before them."""
    x, y = half_m
    inner = (STREET_M - CARRIAGEWAY_M) / 2
    faces = facades.outline([(-x, -y), (-x, y), (x, y), (x, -y)], rng, 18.0)
    for side in (-1.0, 1.0):
        edges = sorted((side * x, side * (x - inner))), sorted((side * y, side * (y - inner)))
        faces += raised((edges[0][0], -y), (edges[0][1], y))
        faces += raised((-x + inner, edges[1][0]), (x - inner, edges[1][1]))
    return faces


def _along_street(
    scene: CourtyardScene, start: Array, end: Array, rng: np.random.Generator
) -> list[Face]:
    """Things on the pavement by the kerb, and parked vans."""
    length_m = float(np.linalg.norm(end - start))
    along = (end - start) / length_m
    right = np.array([along[1], -along[0]])
    yaw_rad = float(np.arctan2(along[1], along[0]))
    faces: list[Face] = []
    for at_m in np.arange(3.0, length_m, 8.0) + rng.uniform(-1, 1):
        place = start + at_m * along + 0.6 * right
        # Nothing before the ways that lead off the street.
        if off_lanes_m(scene, place) > _ROOM_M:
            faces += street.thing(np.append(place, KERB_M), yaw_rad, rng)
    if rng.random() < 0.45:
        place = start + float(rng.uniform(4, length_m - 4)) * along - 1.15 * right
        turn = float(rng.choice([0, np.pi]))
        ends = [place + side * along for side in (-2.5, 0.0, 2.5)]
        if min(off_lanes_m(scene, end) for end in ends) > _VAN_ROOM_M:
            faces += street.van(np.append(place, 0.0), yaw_rad + turn, rng)
    return faces
