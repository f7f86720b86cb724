"""An industrial hall."""

from __future__ import annotations

import numpy as np

from covinz.scenario.scenes import HallScene
from covinz_agents.world.builders import box, column, level, tiles, upright
from covinz_agents.world.geometry import World


def hall(scene: HallScene) -> World:
    """An industrial hall with free space in its middle."""
    rng = np.random.default_rng([scene.seed, 1])
    length, width, height = scene.size_m
    x, y = length / 2, width / 2
    faces = []
    walls = [
        upright((x, 0, height / 2), (-1, 0, 0), width, height, "concrete"),
        upright((-x, 0, height / 2), (1, 0, 0), width, height, "concrete"),
        upright((0, y, height / 2), (0, -1, 0), length, height, "concrete"),
        upright((0, -y, height / 2), (0, 1, 0), length, height, "concrete"),
        level((0, 0, 0), 0, length, width, "concrete"),
        level((0, 0, height), 0, length, width, "concrete", facing_up=False),
    ]
    for wall in walls:
        faces += tiles(wall, 4.0)
    for _ in range(20):
        side = rng.choice([-1, 1])
        at = (rng.uniform(-x + 1, x - 1), side * (y - 0.8), 0)
        faces += box(at, rng.uniform(0.8, 2.0, 3).tolist(), "concrete", yaw_rad=rng.normal(0, 0.1))
    for px in (-5.0, 5.0):
        for py in (-3.5, 3.5):
            faces += column((px, py, 0), 0.3, height, "concrete")
    return World(
        tuple(faces),
        np.array([-x + 1, -y + 1, 0.3]),
        np.array([x - 1, y - 1, height - 2]),
        False,
        scene.seed,
    )
