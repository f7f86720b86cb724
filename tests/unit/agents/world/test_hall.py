"""The hall: room to move in its middle, something to see all around, the seed's own."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.world.build import build_world
from covinz_agents.world.clearance import clearance_m, first_hit_m
from covinz_agents.world.plan import plan

from covinz.scenario import HallScene
from tests.small_world import SCENE

SCENES = {"default": HallScene(kind="hall"), "small": HallScene.model_validate(SCENE)}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_robots_have_room_to_move(scene: HallScene) -> None:
    hall = build_world(scene)
    points = np.random.default_rng(0).uniform([*hall.low_m[:2], 1.1], hall.high_m, (800, 3))
    assert np.mean(clearance_m(hall, points) > 0.8) > 0.4


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_no_ray_leaves_the_hall(scene: HallScene) -> None:
    rays = np.random.default_rng(1).normal(size=(2000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hit_m = first_hit_m(build_world(scene), (0.0, 0.0, 1.5), rays)
    assert np.isfinite(hit_m).all()
    assert hit_m.max() < np.linalg.norm(scene.size_m)


def test_a_seed_gives_the_same_hall_and_another_one_another() -> None:
    first, again, other = (
        build_world(HallScene(kind="hall", seed=seed)).digest for seed in (1, 1, 2)
    )
    assert first == again != other


def test_what_stands_in_it_is_on_the_plan() -> None:
    scene = HallScene(kind="hall")
    outlines = plan(build_world(scene))
    corners = np.concatenate(outlines)
    assert len(outlines) > 100
    np.testing.assert_allclose(corners.min(axis=0), [-10.0, -7.5], atol=0.2)
    np.testing.assert_allclose(corners.max(axis=0), [10.0, 7.5], atol=0.2)


@pytest.mark.parametrize("size_m", [(5.0, 15.0, 8.0), (20.0, 15.0, 3.0)])
def test_a_hall_without_room_is_refused(size_m: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="a hall is at least"):
        build_world(HallScene(kind="hall", size_m=size_m))
