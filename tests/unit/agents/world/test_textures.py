"""Textures: every material at every shape, each face its own, the same again."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.world.build import build_world
from covinz_agents.world.geometry import Face, World
from covinz_agents.world.noise import Patch
from covinz_agents.world.textures import MATERIALS, painted_texture, texture_size_px

from covinz.scenario import CourtyardScene, HallScene, MachineHallScene
from tests.small_room import room


def patch(width_m: float, height_m: float) -> Patch:
    rng = np.random.default_rng(3)
    return Patch(rng, max(16, int(40 * width_m)), max(16, int(40 * height_m)), width_m, height_m)


@pytest.mark.parametrize("material", sorted(MATERIALS))
def test_a_material_covers_faces_of_any_shape(material: str) -> None:
    for width_m, height_m in ((2.0, 1.5), (3.0, 0.05), (0.05, 3.0), (0.2, 0.2)):
        image = MATERIALS[material](patch(width_m, height_m))
        assert image.shape == (*patch(width_m, height_m).shape, 3)
        assert np.isfinite(image).all()
    large = MATERIALS[material](patch(2.0, 1.5))
    assert 10 < large.mean() < 256
    # Something to see, but no soup of noise: neighbours are alike.
    assert large.std() > 2
    step = np.abs(np.diff(large.mean(axis=2), axis=1)).mean()
    assert step < 1.5 * large.std()


def test_every_scene_is_made_of_known_materials() -> None:
    path = np.array([[0.0, 0.0, 1.0], [8.0, 5.0, 2.0]])
    scenes = (
        HallScene(kind="hall"),
        CourtyardScene(kind="courtyard"),
        MachineHallScene(kind="machine_hall"),
    )
    used = {face.material for scene in scenes for face in build_world(scene, path).faces}
    assert used <= set(MATERIALS)


def test_no_two_faces_or_variants_or_worlds_share_a_texture() -> None:
    def alike(seed: int) -> World:
        face = Face(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, -1.0]), "machine")
        return World((face,) * 8, np.zeros(3), np.ones(3), outdoors=False, seed=seed)

    textures = [painted_texture(alike(0), number) for number in range(8)]
    textures += [painted_texture(alike(0), number, variant=1) for number in range(8)]
    textures += [painted_texture(alike(1), number) for number in range(8)]
    for i, one in enumerate(textures):
        for other in textures[:i]:
            assert np.mean(np.abs(one.astype(float) - other)) > 3


def test_a_texture_is_the_same_again() -> None:
    for number in range(len(room().faces)):
        first = painted_texture(room(), number)
        assert np.array_equal(first, painted_texture(room(), number))
        width, height = texture_size_px(room().faces[number])
        assert first.shape == (height, width, 3)


def test_an_unknown_material_is_named() -> None:
    face = Face(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, -1.0]), "velvet")
    with pytest.raises(ValueError, match="velvet"):
        painted_texture(World((face,), np.zeros(3), np.ones(3), outdoors=False), 0)
