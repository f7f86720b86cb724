"""Light: Lambert's law where nothing is in the way, shadows where something is."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.world.baking import bake, grid_sizes
from covinz_agents.world.builders import UP, box, level
from covinz_agents.world.geometry import Face, World
from covinz_agents.world.lights import FarLights, Lighting, PointLights, lighting
from covinz_agents.world.shadows import ShadowMaps

from covinz.types import Array
from tests.small_room import room

NO_POINTS = PointLights(*(np.empty((0, 3)) for _ in range(3)))
NO_FAR = FarLights(np.empty((0, 3)), np.empty((0, 3)))


def world(*faces: Face) -> World:
    return World(faces, np.zeros(3), np.ones(3), outdoors=False)


def light_of(given: World, points: PointLights, far: FarLights) -> list[Array]:
    """Light (rows, columns) of each face, without what is reflected by others."""
    none = np.zeros((len(given.faces), 3))
    baked = bake(given, Lighting(points, far, none, np.zeros(3), UP)).mean(axis=1)
    sizes = grid_sizes(given)
    ends = np.cumsum([rows * columns for rows, columns in sizes])
    parts = np.split(baked, ends[:-1])
    return [part.reshape(size) for part, size in zip(parts, sizes, strict=True)]


FLOOR = level(np.zeros(3), 0.0, 4.0, 4.0, "floor")


def test_the_sun_lights_by_the_cosine_and_a_box_throws_its_shadow() -> None:
    sun = np.array([0.6, 0.0, 0.8])
    roof = level((0.0, 0.0, 1.0), 0.0, 1.0, 1.0, "floor")
    far = FarLights(sun[None], np.ones((1, 3)))
    floor, shade = light_of(world(FLOOR, roof), NO_POINTS, far)
    np.testing.assert_allclose(shade, shade[0, 0])
    x, y = _middles(FLOOR, floor)
    # A metre below the roof its shadow is 0.75 m further from the sun.
    inside = (np.abs(x + 0.75) < 0.4) & (np.abs(y) < 0.4)
    outside = (np.abs(x + 0.75) > 0.6) | (np.abs(y) > 0.6)
    assert (floor[inside] == 0).all()
    np.testing.assert_allclose(floor[outside], shade[0, 0])


def test_a_lamp_lights_by_cosines_and_distance_and_a_box_throws_its_shadow() -> None:
    lamp = PointLights(np.array([[0.0, 0, 2.0]]), -UP[None], np.ones((1, 3)))
    floor, *_ = light_of(world(FLOOR, *box((1.0, 0, 0), (0.4, 0.4, 1.0), "crate")), lamp, NO_FAR)
    x, y = _middles(FLOOR, floor)
    # Light is measured 5 cm above the floor.
    squared = x**2 + y**2 + 1.95**2
    expected = 1.95**2 / (squared * (squared + 0.01))
    free = (x < 0) | (np.abs(y) > 0.8)
    ratio = floor[free] / expected[free]
    np.testing.assert_allclose(ratio, np.median(ratio), rtol=0.05)
    behind = (x > 1.4) & (x < 1.9) & (np.abs(y) < 0.2)
    assert behind.any()
    assert (floor[behind] < 0.01 * floor.max()).all()


def test_shadow_maps_see_what_is_in_sight() -> None:
    with ShadowMaps(world(FLOOR, *box((1.0, 0, 0), (0.4, 0.4, 1.0), "crate"))) as shadows:
        at = np.array([[1.0, 0, 1.05], [1.6, 0, 0.05], [-1.0, 1.0, 0.05], [1.9, 1.9, 0.05]])
        seen = shadows.seen_from_point(np.array([0.0, 0, 2.0]), -UP, at)
        assert seen.tolist() == [True, False, True, True]


def test_surfaces_out_of_sight_of_all_lamps_are_lit_by_the_others() -> None:
    given = room()
    baked = bake(given, lighting(given, 0)).mean(axis=1)
    assert (baked > 0.01).all()
    assert 0.2 < np.median(baked) < 1.0


@pytest.mark.parametrize("outdoors", [False, True])
def test_each_number_is_another_light_and_the_same_again(outdoors: bool) -> None:
    given = room(outdoors=outdoors)
    first, other, again = (bake(given, lighting(given, light)) for light in (0, 1, 0))
    assert np.array_equal(first, again)
    assert np.mean(np.abs(first - other)) > 0.01


def _middles(face: Face, light: Array) -> tuple[Array, Array]:
    """World x and y of the middles of a level face's grid."""
    rows, columns = light.shape
    t, s = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns,
                       indexing="ij")  # fmt: skip
    at = face.corner_m + s[..., None] * face.u_m + t[..., None] * face.v_m
    return at[..., 0], at[..., 1]
