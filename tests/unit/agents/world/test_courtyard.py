"""The campus: its plan, what is in it, and that robots can walk through it."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.world import campus_plan
from covinz_agents.world.build import build_world
from covinz_agents.world.clearance import clearance_m, first_hit_m
from covinz_agents.world.geometry import World
from covinz_agents.world.textures import painted_texture, texture_size_px

from covinz.scenario import CourtyardScene
from covinz.types import Array

SCENE = CourtyardScene(kind="courtyard", seed=3)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(SCENE)


def on_lanes_m(step_m: float, height_m: float) -> Array:
    """(N, 3) points along the middles of all lanes."""
    points = []
    for start, end, _ in campus_plan.lanes_m(SCENE):
        number = max(2, int(np.linalg.norm(end - start) / step_m))
        points.append(start + np.linspace(0, 1, number)[:, None] * (end - start))
    plane = np.concatenate(points)
    return np.column_stack([plane, np.full(len(plane), height_m)])


def test_streets_divide_the_whole_size() -> None:
    xs, ys = campus_plan.street_lines_m(SCENE)
    np.testing.assert_allclose(xs, [-72, -24, 24, 72])
    np.testing.assert_allclose(ys, [-47, 0, 47])
    for block in campus_plan.blocks(SCENE):
        np.testing.assert_allclose(np.subtract(block.high_m, block.low_m), [32, 31])


def test_the_plan_grows_with_the_size() -> None:
    wide = SCENE.model_copy(update={"size_m": (220.0, 160.0)})
    assert campus_plan.blocks(wide)[0].low_m == (-94.0, -64.0)
    outermost = np.max([face.corner_m for face in build_world(wide).faces], axis=0)
    assert outermost[0] >= 109
    assert outermost[1] >= 79


def test_refuses_a_size_without_room_for_blocks() -> None:
    with pytest.raises(ValueError, match="needs 148 m"):
        build_world(SCENE.model_copy(update={"size_m": (120.0, 110.0)}))


def test_nothing_stands_in_the_lanes(world: World) -> None:
    """On eye level nothing is nearer to a lane's middle than half its width."""
    for start, end, width_m in campus_plan.lanes_m(SCENE):
        number = int(np.linalg.norm(end - start))
        plane = start + np.linspace(0, 1, number)[:, None] * (end - start)
        points = np.column_stack([plane, np.full(len(plane), 1.6)])
        # The ground is 1.6 m below, so that more cannot be seen of wider lanes.
        assert clearance_m(world, points).min() >= min(width_m / 2, 1.6 - campus_plan.KERB_M) - 1e-6


def test_robots_have_fronts_in_view(world: World) -> None:
    """Half of what is seen on eye level is nearer than 20 m, and hardly anything near the lens."""
    origins = on_lanes_m(8.0, 1.6)
    yaw = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    rays = np.stack([np.cos(yaw), np.sin(yaw), np.full(8, 0.02)], axis=1)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    seen = first_hit_m(world, np.repeat(origins, 8, axis=0), np.tile(rays, (len(origins), 1)))
    assert np.median(seen) < 20
    assert seen.min() > 1.4
    # Streets end at houses: on this height no view leaves the campus.
    assert np.mean(np.isinf(seen)) < 0.01


def test_faces_look_at_the_robots(world: World) -> None:
    """What is first met along a ray, from either side, is hardly ever the back of a face."""
    origins = on_lanes_m(9.0, 1.6)
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(len(origins), 3)) * [1, 1, 0.15]
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    seen = first_hit_m(world, origins, rays)
    turned = World(
        tuple(type(f)(f.corner_m, f.v_m, f.u_m, f.material) for f in world.faces),
        world.low_m, world.high_m, world.outdoors,
    )  # fmt: skip
    from_behind = first_hit_m(turned, origins, rays)
    assert np.mean(from_behind < seen - 1e-6) < 0.03


def test_is_inside_its_extent(world: World) -> None:
    corners = np.concatenate(
        [[f.corner_m, f.corner_m + f.u_m, f.corner_m + f.v_m] for f in world.faces]
    )
    # Roofs lean outwards behind the houses around it.
    assert np.abs(corners[:, 0]).max() <= 80 + 3
    assert np.abs(corners[:, 1]).max() <= 55 + 3
    assert corners[:, 2].min() >= 0
    assert world.outdoors


def test_the_seed_decides(world: World) -> None:
    def first(made: World) -> Array:
        return np.array([face.corner_m for face in made.faces[:2000]])

    np.testing.assert_array_equal(first(world), first(build_world(SCENE)))
    assert world.seed == SCENE.seed
    other = build_world(SCENE.model_copy(update={"seed": 4}))
    assert not np.array_equal(first(world), first(other))


def test_every_material_is_painted(world: World) -> None:
    """Each kind once: textures of their size, with something to see in all but a few."""
    first = {face.material: number for number, face in reversed(list(enumerate(world.faces)))}
    for material, number in first.items():
        texture = painted_texture(world, number)
        width, height = texture_size_px(world.faces[number], outdoors=True)
        assert texture.shape == (height, width, 3)
        assert material == "van_roof" or texture.std() > 4, material


def test_textures_fit_into_memory(world: World) -> None:
    """Well under half a gigabyte with three bytes a pixel and smaller copies for the distance."""
    sizes = [texture_size_px(face, outdoors=True) for face in world.faces]
    assert sum(width * height for width, height in sizes) * 3 * 4 / 3 < 500e6
