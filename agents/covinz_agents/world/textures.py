"""Textures of faces: each its own, painted from the seed of the world and the face's number."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from covinz_agents.world import (
    textures_hall,
    textures_houses,
    textures_machines,
    textures_street,
)
from covinz_agents.world.geometry import Face, World
from covinz_agents.world.noise import Field, Patch, finished

# Widths and heights of textures, all divisible by 16 so that mip levels stay aligned. Few of
# them, so that faces of a size can be drawn together.
_SIDES_PX = np.array([16, 32, 64, 96, 128, 192, 256, 384, 512, 768])
# Texture pixels per metre of small things and of large surfaces (longest side of 5 m or more).
_SMALL_PX_PER_M, _LARGE_PX_PER_M = 190.0, 110.0

# Of that, outdoors, where everything is further away.
_OUTDOORS_SHARE = 0.4

# Every material by its name.
MATERIALS: Mapping[str, Callable[[Patch], Field]] = {
    **textures_hall.MATERIALS,
    **textures_machines.MATERIALS,
    **textures_houses.MATERIALS,
    **textures_street.MATERIALS,
}


def texture_size_px(face: Face, *, outdoors: bool = False) -> tuple[int, int]:
    """Width and height of a face's texture."""
    sides_m = np.linalg.norm(face.u_m, axis=-1), np.linalg.norm(face.v_m, axis=-1)
    longest = max(sides_m)
    share = np.clip((longest - 1.0) / 4.0, 0, 1)
    density = _SMALL_PX_PER_M + share * (_LARGE_PX_PER_M - _SMALL_PX_PER_M)
    density *= _OUTDOORS_SHARE if outdoors else 1.0
    width, height = (
        int(_SIDES_PX[np.abs(np.log(_SIDES_PX / (side * density))).argmin()]) for side in sides_m
    )
    return width, height


def painted_texture(world: World, number: int, variant: int = 0) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 BGR albedo of a face: 255 times its square root.

    Args:
        world: The world.
        number: Which of its faces.
        variant: Another one gives another texture of the same material.

    Raises:
        ValueError: If the face's material is unknown.
    """
    face = world.faces[number]
    if face.material not in MATERIALS:
        raise ValueError(f"unknown material {face.material!r}")
    width, height = texture_size_px(face, outdoors=world.outdoors)
    patch = Patch(
        np.random.default_rng([world.seed, number, variant]),
        width,
        height,
        float(np.linalg.norm(face.u_m)),
        float(np.linalg.norm(face.v_m)),
    )
    return finished(MATERIALS[face.material](patch))
