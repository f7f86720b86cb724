"""A world's textures as they look on one visit: what was painted, times the light on it."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz.scenario.scenes import Look
from covinz_agents.world.geometry import World
from covinz_agents.world.textures import painted_texture

Rgb = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Faces whose textures have one size.

    Attributes:
        faces: Their numbers.
        images: (N, H, W, 3) uint8 BGR: 255 times the square root of their radiance.
    """

    faces: tuple[int, ...]
    images: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Sky:
    """What is seen beyond all faces; BGR radiance.

    Attributes:
        zenith: Straight up.
        horizon: At and below the horizon.
        cloud: Of clouds.
        clouds: (H, W) uint8 cover, tileable.
    """

    zenith: Rgb
    horizon: Rgb
    cloud: Rgb
    clouds: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Painted:
    """All textures of a world.

    Attributes:
        batches: Faces by the size of their textures.
        layers: Of each face, which of its batch's images is its.
        sky: What is beyond.
    """

    batches: tuple[Batch, ...]
    layers: tuple[int, ...]
    sky: Sky


def paint(world: World, look: Look) -> Painted:
    """Textures of a world on one visit."""
    images = [painted_texture(world, number) for number in range(len(world.faces))]
    numbers = defaultdict(list)
    for number, image in enumerate(images):
        numbers[image.shape].append(number)
    layers = [0] * len(images)
    for faces in numbers.values():
        for layer, number in enumerate(faces):
            layers[number] = layer
    sky = Sky((0.9, 0.6, 0.4), (0.9, 0.8, 0.7), (0.9, 0.9, 0.9), np.zeros((64, 64), "u1"))
    return Painted(
        tuple(Batch(tuple(f), np.stack([images[n] for n in f])) for f in numbers.values()),
        tuple(layers),
        sky,
    )
