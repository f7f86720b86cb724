"""Rays of raw pixels: the core's camera models agree, and views show every one of them."""

from __future__ import annotations

import covinz_core
import numpy as np
import pytest
from covinz_agents.world import lens

from covinz.types import Camera
from tests.small_room import LENSES, camera


@pytest.mark.parametrize("model", sorted(LENSES))
def test_every_ray_projects_onto_its_pixel(model: str) -> None:
    given = camera(model)
    rays = lens.pixel_rays(given).reshape(-1, 3)
    rows, columns = np.divmod(np.arange(len(rays)), given.width)
    seen_px = covinz_core.project_points(model, list(given.params), 3.0 * rays)
    np.testing.assert_allclose(seen_px, np.stack([columns, rows], axis=1), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("model", sorted(LENSES))
def test_views_show_every_pixel_once_and_where_its_ray_meets_them(model: str) -> None:
    given = camera(model)
    rays = lens.pixel_rays(given).reshape(-1, 3)
    views = lens.views(given, 1.3)
    taken = np.concatenate([view.pixels for view in views])
    assert sorted(taken.tolist()) == list(range(given.width * given.height))
    for view in views:
        seen = rays[view.pixels] @ view.R_view_cam.T
        at_px = view.focal_px * seen[:, :2] / seen[:, 2:] + view.center_px
        np.testing.assert_allclose(view.x_px, at_px[:, 0], atol=1e-3)
        np.testing.assert_allclose(view.y_px, at_px[:, 1], atol=1e-3)
        assert view.x_px.min() >= 1
        assert view.y_px.min() >= 1
        assert view.x_px.max() <= view.size_px[0] - 2
        assert view.y_px.max() <= view.size_px[1] - 2


def test_a_wide_lens_takes_several_views_and_an_ordinary_one_takes_one() -> None:
    assert len(lens.views(camera("OPENCV"), 1.0)) == 1
    assert len(lens.views(camera("OPENCV_FISHEYE"), 1.0)) > 1


def test_pixels_beyond_the_image_circle_see_nothing() -> None:
    # 160 degrees across the height: the corners are more than 180 degrees from the axis.
    given = Camera(
        "OPENCV_FISHEYE", 200, 100, np.array([30.0, 30, 99.5, 49.5, 0, 0, 0, 0]), np.eye(4)
    )
    rays = lens.pixel_rays(given)
    radius_rad = np.hypot(*(np.indices((100, 200)).transpose(1, 2, 0) - [49.5, 99.5]).T).T / 30
    assert np.array_equal(np.isnan(rays[..., 0]), radius_rad >= np.pi)
    taken = np.concatenate([view.pixels for view in lens.views(given, 1.0)])
    assert len(taken) == np.sum(radius_rad < np.pi)
