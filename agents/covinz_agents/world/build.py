"""The world of a scene."""

from __future__ import annotations

from numpy.typing import ArrayLike

from covinz.scenario.scenes import CourtyardScene, HallScene, MachineHallScene, Scene
from covinz_agents.world.courtyard import courtyard
from covinz_agents.world.geometry import World
from covinz_agents.world.hall import hall
from covinz_agents.world.machine_hall import machine_hall


def build_world(scene: Scene, keep_clear_m: ArrayLike = ()) -> World:
    """Build what a scene describes; the same scene gives the same world.

    Args:
        scene: Which world, and its seed.
        keep_clear_m: (N, 3) points of given paths, around which nothing is put; only scenes
            that are built around paths use them.

    Raises:
        ValueError: If the scene leaves no room for what belongs in it.
    """
    match scene:
        case HallScene():
            return hall(scene)
        case CourtyardScene():
            return courtyard(scene)
        case MachineHallScene():
            return machine_hall(scene, keep_clear_m)
