"""The plan shows what stands in a world, wherever its floor is."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.world.builders import box, level
from covinz_agents.world.geometry import World
from covinz_agents.world.plan import plan


@pytest.mark.parametrize("floor_m", [0.0, -2.3, 5.0])
def test_what_stands_is_in_it_and_floor_and_roof_are_not(floor_m: float) -> None:
    ground = level((0, 0, floor_m), 0.0, 20, 20, "floor")
    roof = level((0, 0, floor_m + 7), 0.0, 20, 20, "ceiling", facing_up=False)
    crate = box((3, 2, floor_m), (2, 1, 1.5), "crate")
    lamp = box((0, 0, floor_m + 6), (1, 1, 0.3), "steel", without=())
    kerb = box((5, 5, floor_m), (1, 1, 0.1), "kerb")
    world = World((ground, roof, *crate, *lamp, *kerb), np.zeros(3), np.ones(3), False)
    polygons = plan(world)
    # Four sides as lines, and the top.
    assert sorted(len(polygon) for polygon in polygons) == [2, 2, 2, 2, 4]
    corners = np.concatenate(polygons)
    np.testing.assert_allclose(corners.min(axis=0), [2, 1.5])
    np.testing.assert_allclose(corners.max(axis=0), [4, 2.5])


def test_an_empty_world_has_an_empty_plan() -> None:
    assert plan(World((), np.zeros(3), np.ones(3), True)) == []
