"""A room with a box and a lamp, for tests of images: painted in a fraction of a second."""

from __future__ import annotations

import numpy as np
from covinz_agents.world.builders import UP, box, level, upright
from covinz_agents.world.geometry import Face, World

from covinz import frames
from covinz.types import Array, Camera

SIZE_M = np.array([4.0, 3.0, 2.4])
LENSES = {
    "PINHOLE": (95.0, 94.0, 80.3, 58.6),
    "OPENCV": (90.0, 91.0, 79.0, 60.5, -0.283, 0.074, 2e-4, 2e-5),
    "FULL_OPENCV": (92.0, 92.5, 80.1, 59.2, 0.3, -0.05, 1e-3, -5e-4, 0.01, 0.45, 0.02, 0.01),
    "OPENCV_FISHEYE": (58.0, 58.5, 79.2, 60.1, -0.01, 0.004, -0.002, 3e-4),
}


def room(*, outdoors: bool = False) -> World:
    """Walls, floor, a box in the middle; indoors a ceiling with a lamp."""
    x, y, z = SIZE_M / 2
    faces: list[Face] = [level(np.zeros(3), 0.0, 2 * x, 2 * y, "floor")]
    for normal, at, width in (((-1, 0), (x, 0), 2 * y), ((1, 0), (-x, 0), 2 * y),
                              ((0, -1), (0, y), 2 * x), ((0, 1), (0, -y), 2 * x)):  # fmt: skip
        faces.append(upright((*at, z), (*normal, 0), width, 2 * z, "cladding"))
    faces += box((0.3, 0.2, 0), (0.7, 0.5, 0.8), "crate", yaw_rad=0.3)
    if not outdoors:
        faces.append(level(2 * z * UP, 0.0, 2 * x, 2 * y, "ceiling", facing_up=False))
        faces.append(level((0.3, 0.2, 2 * z - 0.05), 0.0, 0.6, 0.3, "lamp", facing_up=False))
    low, high = np.array([-x, -y, 0.2]), np.array([x, y, 2 * z])
    return World(tuple(faces), low, high, outdoors, seed=5)


def camera(model: str) -> Camera:
    """A small camera of a COLMAP model."""
    return Camera(model, 160, 120, np.array(LENSES[model]), np.eye(4))


def looking(at_m: tuple[float, float, float], yaw_rad: float, pitch_rad: float = 0.0) -> Array:
    """``T_world_cam`` (4, 4) of a level camera that looks along a heading, up by the pitch."""
    ahead = np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0])
    forward = np.cos(pitch_rad) * ahead + np.sin(pitch_rad) * UP
    right = np.cross(ahead, UP)
    return frames.transform(np.stack([right, np.cross(forward, right), forward], axis=1), at_m)
