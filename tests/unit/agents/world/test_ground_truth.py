"""The generated hall as the rest of the system needs it: exact, rich, and matchable."""

from __future__ import annotations

from collections.abc import Iterator

import covinz_core
import cv2
import numpy as np
import pytest
from covinz_agents.features import extract
from covinz_agents.world import lens
from covinz_agents.world.build import build_world
from covinz_agents.world.geometry import World
from covinz_agents.world.renderer import Renderer, Rendering
from covinz_agents.world.sensor import expose
from numpy.typing import NDArray

from covinz.config import FeatureConfig
from covinz.scenario import HallScene, Look, Sensor
from covinz.scenario.rendered import WIDE_LENS
from covinz.types import Array, Camera
from tests.small_room import looking

pytestmark = pytest.mark.slow

LENSES = {
    "PINHOLE": (458.0, 457.0, 367.0, 248.0),
    "OPENCV": WIDE_LENS.params,
    "OPENCV_FISHEYE": (270.0, 269.0, 373.0, 241.0, -0.01, 0.004, -0.002, 3e-4),
}
PERFECT = Sensor(shot_noise=0, read_noise=0, vignette=0, exposure_lag=0)
PLACES = [(0, 0, 1.6, 0.3), (-2, -1, 2, 2), (2, 2, 1.5, -1.5), (0, -1, 1.3, 3.6)]


def camera(model: str) -> Camera:
    return Camera(model, 752, 480, np.array(LENSES[model]), np.eye(4))


@pytest.fixture(scope="module")
def hall() -> World:
    return build_world(HallScene(kind="hall"))


@pytest.fixture(scope="module")
def renderer(hall: World) -> Iterator[Renderer]:
    with Renderer(hall, Look(), camera("OPENCV")) as opened:
        yield opened


@pytest.mark.parametrize("model", sorted(LENSES))
def test_depth_and_pose_carry_features_from_one_image_to_another(hall: World, model: str) -> None:
    errors = []
    with Renderer(hall, Look(), camera(model)) as opened:
        for x, y, z, yaw_rad in PLACES:
            first = looking((x, y, z), yaw_rad)
            second = looking((x + 0.15, y + 0.2, z + 0.1), yaw_rad + 0.06, 0.03)
            errors.append(_transfer_errors_px(opened, camera(model), first, second))
    all_px = np.concatenate(errors)
    assert len(all_px) > 1000
    assert np.abs(all_px.mean(axis=0)).max() < 0.05
    assert np.abs(np.median(all_px, axis=0)).max() < 0.05
    assert np.median(np.linalg.norm(all_px, axis=1)) < 0.3


def test_features_cover_the_images_along_a_path(renderer: Renderer) -> None:
    shares = []
    for k in range(12):
        angle = 2 * np.pi * k / 12
        pose = looking((4 * np.cos(angle), 2.5 * np.sin(angle), 1.7), angle + np.pi / 2 - 1.2)
        image = expose(renderer.render(pose).image, Sensor(), np.random.default_rng(k))
        cells = (extract(image, FeatureConfig()).keypoints_px * [8 / 752, 6 / 480]).astype(int)
        shares.append(len({tuple(cell) for cell in cells.tolist()}) / 48)
    assert np.mean(shares) >= 0.75


def test_another_visit_looks_different_and_still_matches(hall: World, renderer: Renderer) -> None:
    pose = looking(PLACES[0][:3], PLACES[0][3])
    first = _grey(renderer.render(pose))
    with Renderer(hall, Look(light=2, changed=0.15, seed=7), camera("OPENCV")) as opened:
        second = _grey(opened.render(looking((0.2, 0.2, 1.7), 0.35)))
        same_place = _grey(opened.render(pose))
    assert np.mean(np.abs(first.astype(float) - same_place)) > 4
    _, _, matches = _sift_matches(first, second)
    assert len(matches) > 150


def _transfer_errors_px(opened: Renderer, lens_of: Camera, T_a: Array, T_b: Array) -> Array:
    """(N, 2) where matched features are in the second image, less where they ought to be."""
    first, second = opened.render(T_a), opened.render(T_b)
    from_px, to_px, _ = _sift_matches(_grey(first), _grey(second))
    depth = _between_pixels(first.depth_m, from_px)
    rays = _between_pixels(lens.pixel_rays(lens_of).astype(np.float32), from_px)
    column, row = np.rint(from_px).astype(int).T
    # At edges of things the depth between pixels means nothing.
    smooth = np.abs(depth - first.depth_m[row, column]) < 0.02 * depth
    in_a = rays / rays[:, 2:] * depth[:, None]
    in_b = (in_a @ T_a[:3, :3].T + T_a[:3, 3] - T_b[:3, 3]) @ T_b[:3, :3]
    expected = covinz_core.project_points(
        lens_of.model, list(lens_of.params), in_b.astype(np.float64)
    )
    errors = (to_px - expected)[smooth]
    # Wrong matches are a matter of the matcher.
    return np.asarray(errors[np.abs(errors).max(axis=1) < 3])


def _between_pixels(image: NDArray[np.float32], at_px: Array) -> NDArray[np.float32]:
    x, y = at_px.astype(np.float32).T
    return np.squeeze(cv2.remap(image, x, y, cv2.INTER_LINEAR))


def _grey(rendered: Rendering) -> NDArray[np.uint8]:
    image = expose(rendered.image, PERFECT, np.random.default_rng(0))
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _sift_matches(
    first: NDArray[np.uint8], second: NDArray[np.uint8]
) -> tuple[Array, Array, list[cv2.DMatch]]:
    sift = cv2.SIFT.create(3000)
    (a, about_a), (b, about_b) = (sift.detectAndCompute(image, None) for image in (first, second))
    pairs = cv2.BFMatcher().knnMatch(about_a, about_b, k=2)
    matches = [best for best, next_best in pairs if best.distance < 0.7 * next_best.distance]
    return (
        np.array([a[match.queryIdx].pt for match in matches]),
        np.array([b[match.trainIdx].pt for match in matches]),
        matches,
    )
