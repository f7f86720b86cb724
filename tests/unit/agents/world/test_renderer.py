"""Images of a small room: exact depth, the same bits again, other looks, no EGL."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from covinz_agents.source import DatasetError
from covinz_agents.world import lens
from covinz_agents.world.clearance import first_hit_m
from covinz_agents.world.geometry import World
from covinz_agents.world.renderer import Renderer, RenderError
from covinz_agents.world.textures import painted_texture

from covinz.scenario import Look
from tests.small_room import LENSES, camera, looking, room

POSE = looking((-1.2, -0.8, 1.1), 0.6, -0.1)


@pytest.fixture(scope="module")
def renderer() -> Iterator[Renderer]:
    with Renderer(room(), Look(), camera("OPENCV")) as opened:
        yield opened


@pytest.mark.parametrize("model", sorted(LENSES))
def test_depth_is_what_a_ray_caster_finds(model: str) -> None:
    given = camera(model)
    with Renderer(room(), Look(), given) as opened:
        rendered = opened.render(POSE)
    rays = lens.pixel_rays(given).reshape(-1, 3)
    cast = first_hit_m(room(), POSE[:3, 3], rays @ POSE[:3, :3].T) * rays[:, 2]
    off = np.abs(rendered.depth_m.ravel() - cast) / cast
    assert np.isfinite(rendered.depth_m).all()
    # Pixels on an edge see one of the faces that meet there.
    assert np.mean(off > 1e-5) < 0.01
    assert np.quantile(off, 0.98) < 1e-6


def test_the_same_pose_gives_the_same_bits_again(renderer: Renderer) -> None:
    first = renderer.render(POSE)
    renderer.render(looking((1.0, 0.5, 1.3), 3.0))
    with Renderer(room(), Look(), camera("OPENCV")) as another:
        others = [renderer.render(POSE), another.render(POSE)]
    for other in others:
        assert np.array_equal(first.image, other.image)
        assert np.array_equal(first.depth_m, other.depth_m)


def test_another_look_has_another_image_of_the_same_place(renderer: Renderer) -> None:
    first = renderer.render(POSE)
    for look in (Look(light=3), Look(changed=0.5, seed=1)):
        with Renderer(room(), look, camera("OPENCV")) as opened:
            other = opened.render(POSE)
        assert np.array_equal(first.depth_m, other.depth_m)
        assert np.mean(np.abs(first.image - other.image)) > 0.01


def test_what_did_not_change_looks_the_same(renderer: Renderer) -> None:
    with Renderer(room(), Look(changed=0.3, seed=4), camera("OPENCV")) as opened:
        other = opened.render(POSE)
    same = np.all(renderer.render(POSE).image == other.image, axis=2)
    assert 0.05 < same.mean() < 0.999


def test_textures_are_not_mirrored() -> None:
    face = next(face for face in room().faces if face.material == "cladding")
    wall = World((face,), np.zeros(3), np.ones(3), outdoors=True, seed=5)
    texture = painted_texture(wall, 0)
    center = face.corner_m + (face.u_m + face.v_m) / 2 + 1.0 * face.normal
    pose = looking(tuple(center), float(np.arctan2(-face.normal[1], -face.normal[0])))
    with Renderer(wall, Look(), camera("PINHOLE")) as opened:
        drawn = opened.render(pose)
    assert drawn.depth_m.min() > 0.9
    # The part of the wall in view, straight from the texture.
    fx, fy, cx, cy = camera("PINHOLE").params
    x, y = np.meshgrid((np.arange(160) - cx) / fx, (np.arange(120) - cy) / fy)
    u = ((x / np.linalg.norm(face.u_m) + 0.5) * texture.shape[1] - 0.5).astype(np.float32)
    v = ((y / np.linalg.norm(face.v_m) + 0.5) * texture.shape[0] - 0.5).astype(np.float32)
    expected = cv2.cvtColor(cv2.remap(texture, u, v, cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
    root = cv2.cvtColor(np.sqrt(drawn.image), cv2.COLOR_BGR2GRAY)
    straight, mirrored = (
        np.corrcoef(expected.ravel(), image.ravel())[0, 1] for image in (root, root[:, ::-1])
    )
    assert straight > 0.8
    assert abs(mirrored) < 0.5


def test_the_sky_is_infinitely_far() -> None:
    with Renderer(room(outdoors=True), Look(), camera("PINHOLE")) as opened:
        rendered = opened.render(looking((0, -1, 1.0), 1.5, 0.9))
    sky = np.isinf(rendered.depth_m)
    assert 0.2 < sky.mean() < 0.95
    assert rendered.image[sky].min() > 0.1


@pytest.mark.parametrize("missing", ["GLCONTEXT_LINUX_LIBEGL", "GLCONTEXT_LINUX_LIBGL"])
def test_without_egl_the_message_names_the_packages(
    monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    monkeypatch.setenv(missing, "libnothing.so")
    with pytest.raises(RenderError, match="libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri") as raised:
        Renderer(room(), Look(), camera("PINHOLE"))
    assert isinstance(raised.value, DatasetError)
