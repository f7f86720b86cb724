"""Distances to faces and along rays, against geometry that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.world.builders import level
from covinz_agents.world.clearance import clearance_m, first_hit_m
from covinz_agents.world.geometry import Face, World

from tests.small_room import room


def world(*faces: Face) -> World:
    return World(faces, np.zeros(3), np.ones(3), outdoors=False)


FLOOR = level((1.0, 1.0, 0.0), 0.0, 2.0, 2.0, "floor")


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((1, 1, 3), 3.0),
        ((1, 1, -2), 2.0),
        ((0, 0, 0), 0.0),
        ((-3, 1, 4), 5.0),
        ((-1, -2, 2), 3.0),
        ((2.5, 1.5, 0), 0.5),
    ],
)
def test_distance_to_a_square(point: tuple[float, ...], expected: float) -> None:
    np.testing.assert_allclose(clearance_m(world(FLOOR), [point]), [expected], atol=1e-12)


def test_distance_to_a_leaning_parallelogram_is_that_to_its_nearest_point() -> None:
    rng = np.random.default_rng(1)
    face = Face(np.zeros(3), np.array([2.0, 0, 0]), np.array([1.5, 1.0, 0.3]), "floor")
    share = np.stack(np.meshgrid(*[np.linspace(0, 1, 401)] * 2), axis=-1).reshape(-1, 2)
    surface = share @ np.stack([face.u_m, face.v_m])
    points = rng.uniform(-2, 4, (30, 3))
    nearest = [np.linalg.norm(surface - point, axis=1).min() for point in points]
    np.testing.assert_allclose(clearance_m(world(face), points), nearest, atol=6e-3)


def test_the_nearest_of_many_faces_counts_and_chunks_do_not_show() -> None:
    points = np.random.default_rng(2).uniform(-1, 1, (1300, 3))
    together = clearance_m(room(), points)
    alone = [clearance_m(world(face), points) for face in room().faces]
    np.testing.assert_array_equal(together, np.min(alone, axis=0))


def test_rays_hit_the_nearest_face_that_looks_at_them() -> None:
    shelf = level((1.0, 1.0, 1.0), 0.0, 2.0, 2.0, "floor")
    both = world(FLOOR, shelf)
    down, up = (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)
    origins = [(1, 1, 3), (1, 1, 0.5), (1, 1, 0.5), (1, 1, -1), (5, 5, 3)]
    hit = first_hit_m(both, origins, [down, down, up, up, down])
    np.testing.assert_allclose(hit, [2.0, 0.5, np.inf, np.inf, np.inf])


def test_a_slanted_ray_is_measured_along_itself() -> None:
    slanted = np.array([3.0, 0, -4]) / 5
    np.testing.assert_allclose(first_hit_m(world(FLOOR), [(0.5, 1, 1)], [slanted]), [1.25])
