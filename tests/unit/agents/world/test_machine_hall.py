"""The hall around given paths keeps its distance from them and is full all the same."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.world.build import build_world
from covinz_agents.world.clearance import clearance_m, first_hit_m
from covinz_agents.world.geometry import World
from covinz_agents.world.textures import painted_texture, texture_size_px

from covinz.scenario import MachineHallScene
from covinz.types import Array

SCENE = MachineHallScene(kind="machine_hall", seed=5, clearance_m=0.8, margin_m=3.0)


def flight_m() -> Array:
    """(N, 3) a lying eight that rises and falls."""
    t = np.linspace(0, 2 * np.pi, 400)
    return np.stack([6 * np.sin(t), 4 * np.sin(2 * t), 1 + 0.7 * np.cos(t)], axis=1)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(SCENE, flight_m())


def test_nothing_is_near_the_path(world: World) -> None:
    assert clearance_m(world, flight_m()).min() >= SCENE.clearance_m - 1e-6


def test_walls_stand_at_the_margin(world: World) -> None:
    path = flight_m()
    np.testing.assert_allclose(world.low_m[:2], path.min(axis=0)[:2] - 3.0)
    np.testing.assert_allclose(world.high_m, path.max(axis=0) + 3.0)
    assert world.low_m[2] == pytest.approx(path[:, 2].min() - SCENE.clearance_m)
    assert not world.outdoors


def test_every_view_has_something_near(world: World) -> None:
    """A closed hall: every ray hits something, and half of what is level within 8 m."""
    origins = flight_m()[::10]
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(len(origins), 12, 3)) * [1, 1, 0.3]
    rays /= np.linalg.norm(rays, axis=2)[..., None]
    seen = first_hit_m(world, np.repeat(origins, 12, axis=0), rays.reshape(-1, 3))
    assert np.isfinite(seen).all()
    assert np.median(seen.reshape(-1, 12), axis=1).max() < 10
    assert np.median(seen) < 8


def test_is_furnished(world: World) -> None:
    kinds = {face.material for face in world.faces}
    assert {"machine", "tank", "crate", "switches", "pipe", "girder", "wall", "floor"} <= kinds
    assert 300 < len(world.faces) < 3000


def test_fills_more_where_less_is_kept_clear(world: World) -> None:
    wary = build_world(SCENE.model_copy(update={"clearance_m": 2.0}), flight_m())
    assert len(wary.faces) < len(world.faces)


def test_the_seed_decides(world: World) -> None:
    again = build_world(SCENE, flight_m())
    assert len(again.faces) == len(world.faces)
    for one, other in zip(again.faces, world.faces, strict=True):
        np.testing.assert_array_equal(one.corner_m, other.corner_m)
        assert one.material == other.material
    reseeded = build_world(SCENE.model_copy(update={"seed": 6}), flight_m())
    assert [f.material for f in reseeded.faces] != [f.material for f in world.faces]


def test_needs_a_path() -> None:
    with pytest.raises(ValueError, match="at least one"):
        build_world(SCENE)


def test_refuses_walls_nearer_than_the_clearance() -> None:
    with pytest.raises(ValueError, match="margin"):
        build_world(SCENE.model_copy(update={"margin_m": 0.5}), flight_m())


def test_every_material_is_painted(world: World) -> None:
    first = {face.material: number for number, face in reversed(list(enumerate(world.faces)))}
    for material, number in first.items():
        texture = painted_texture(world, number)
        assert texture.shape[:2] == texture_size_px(world.faces[number])[::-1]
        assert texture.std() > 4, material
