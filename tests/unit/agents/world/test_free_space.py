"""Places in a hall: distances to paths, and boxes that must not meet."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.world.free_space import Bounds, FreeSpace
from hypothesis import given
from hypothesis import strategies as st

from covinz.types import Array

LOW, HIGH = np.array([-5.0, -5.0, 0.0]), np.array([5.0, 5.0, 4.0])


def bounds(x: float, y: float, size: tuple[float, float, float], yaw_rad: float = 0.0) -> Bounds:
    return Bounds(np.array([x, y, 0.0]), np.array(size), yaw_rad)


def space(*points: tuple[float, float, float], clearance_m: float = 1.0) -> FreeSpace:
    return FreeSpace(points, clearance_m, LOW, HIGH)


def test_distance_to_a_turned_box() -> None:
    turned = bounds(1, 0, (2, 2, 1), np.pi / 4)
    corner = 1 + np.sqrt(2)
    points = np.array([[corner + 1, 0, 0.5], [1, 0, 3.0], [1, 0, 0.5]])
    np.testing.assert_allclose(
        [turned.distance_m(points[[i]]) for i in range(3)], [1, 2, 0], atol=1e-12
    )


def test_no_path_is_near_where_there_is_none() -> None:
    assert bounds(0, 0, (1, 1, 1)).distance_m(np.empty((0, 3))) == np.inf
    assert space().height_m(bounds(0, 0, (1, 1, 1))) == np.inf


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0, 3))
def test_a_place_as_high_as_may_be_touches_the_clearance(x: float, y: float, yaw: float) -> None:
    path = (0.3, -0.2, 2.5)
    free = space(path)
    height_m = free.height_m(bounds(x, y, (1.5, 0.8, 1.0), yaw))
    if np.isfinite(height_m):
        as_high = bounds(x, y, (1.5, 0.8, height_m), yaw)
        assert as_high.distance_m(np.array([path])) == pytest.approx(1.0)


def footprint(x: float, y: float, yaw_rad: float) -> Array:
    return bounds(x, y, (2, 1, 1), yaw_rad).footprint_m()


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0, 7), st.floats(0, 7))
def test_overlap_is_mutual_and_holds_where_corners_are_inside(
    x: float, y: float, yaw: float, other_yaw: float
) -> None:
    one, other = bounds(0, 0, (2, 1, 1), yaw), bounds(x, y, (2, 1, 1), other_yaw)
    assert one.overlaps(other, 0.1) == other.overlaps(one, 0.1)
    # Boxes that only touch do not overlap.
    core = bounds(0, 0, (2 - 1e-6, 1 - 1e-6, 1), yaw)
    inside = [
        core.distance_m(np.array([[*corner, 0.5]])) == 0 for corner in footprint(x, y, other_yaw)
    ]
    if any(inside):
        assert one.overlaps(other, 0.0)


def test_boxes_above_one_another_do_not_overlap() -> None:
    above = Bounds(np.array([0, 0, 2.0]), np.array([1.0, 1, 1]))
    assert not above.overlaps(bounds(0, 0, (1, 1, 1.5)), 0.3)


def test_takes_what_is_free_once() -> None:
    free = space((0, 0, 2.0))
    assert free.take(bounds(0, 0, (1, 1, 0.9)))
    assert not free.take(bounds(0.5, 0, (1, 1, 0.9)))
    assert free.take(bounds(3, 3, (1, 1, 3)))


@pytest.mark.parametrize(
    "place",
    [
        bounds(0, 0, (1, 1, 1.5)),
        bounds(4.8, 0, (1, 1, 1)),
        bounds(3, 3, (1, 1, 4.5)),
    ],
    ids=["near a path", "through a wall", "through the roof"],
)
def test_refuses(place: Bounds) -> None:
    assert not space((0, 0, 2.0)).take(place)
