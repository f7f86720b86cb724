"""A world's textures as they look on one visit: what was painted, times the light on it."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz.scenario.scenes import Look
from covinz.types import Array
from covinz_agents.array_cache import cached_array
from covinz_agents.cache_folder import source_digest
from covinz_agents.world import (
    baking,
    lights,
    masonry,
    noise,
    shadows,
    textures,
    textures_hall,
    textures_houses,
    textures_machines,
    textures_street,
)
from covinz_agents.world.geometry import World
from covinz_agents.world.sky import Sky, sky

_TEXTURE_CODE = (
    masonry, noise, textures, textures_hall, textures_houses, textures_machines, textures_street,
)  # fmt: skip
_LIGHT_CODE = (baking, lights, shadows)
# Radiance, of what a well-lit white surface has, that is stored as 255: brighter ones are cut.
_BRIGHTEST = 1.3


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
    """Textures of a world on one visit.

    Raises:
        ValueError: If a face's material is unknown.
        RenderError: If the light cannot be computed: there is no EGL.
    """
    light = lights.lighting(world, look.light)
    irradiance = _irradiance(world, look.light, light)
    sizes = [textures.texture_size_px(face, outdoors=world.outdoors) for face in world.faces]
    numbers = defaultdict(list)
    for number, size in enumerate(sizes):
        numbers[size].append(number)
    images = {
        size: np.empty((len(faces), size[1], size[0], 3), np.uint8)
        for size, faces in numbers.items()
    }
    layers = [0] * len(sizes)
    for faces in numbers.values():
        for layer, number in enumerate(faces):
            layers[number] = layer
    for number, albedo in enumerate(_albedo(world, look, sizes)):
        shone = _lit(albedo, irradiance[number], light.emitted[number])
        images[sizes[number]][layers[number]] = shone
    batches = tuple(Batch(tuple(faces), images[size]) for size, faces in numbers.items())
    return Painted(batches, tuple(layers), sky(world.seed, look.light))


def _lit(albedo: NDArray[np.uint8], irradiance: Array, emitted: Array) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 root of radiance."""
    root = np.sqrt((irradiance + emitted) / _BRIGHTEST).astype(np.float32)
    size = albedo.shape[1], albedo.shape[0]
    wide = cv2.resize(root, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.multiply(albedo, wide, dtype=cv2.CV_8U), dtype=np.uint8)


def _albedo(world: World, look: Look, sizes: list[tuple[int, int]]) -> list[NDArray[np.uint8]]:
    """Textures of all faces: those of every visit, and what was changed on this one."""
    rng = np.random.default_rng([world.seed, look.seed, 0x33])
    is_changed = rng.random(len(sizes)) < look.changed
    every = np.arange(len(sizes))
    images = _textures(world, every, sizes, 0)
    if is_changed.any():
        changed = np.flatnonzero(is_changed)
        for number, image in zip(
            changed, _textures(world, changed, sizes, 1 + look.seed), strict=True
        ):
            images[number] = image
    return images


def _textures(
    world: World, numbers: NDArray[np.intp], sizes: list[tuple[int, int]], variant: int
) -> list[NDArray[np.uint8]]:
    """Textures of some faces, from the cache if they are there."""
    pixels = [sizes[number][0] * sizes[number][1] * 3 for number in numbers]
    starts = np.concatenate([[0], np.cumsum(pixels)])

    def painted() -> NDArray[np.uint8]:
        flat = np.empty(starts[-1], dtype=np.uint8)
        for number, start, end in zip(numbers, starts[:-1], starts[1:], strict=True):
            flat[start:end] = textures.painted_texture(world, int(number), variant).ravel()
        return flat

    chosen = np.packbits(np.isin(np.arange(len(sizes)), numbers)).tobytes()
    key = _key(f"{world.digest} {variant} {chosen.hex()} {source_digest(_TEXTURE_CODE)}")
    flat = np.asarray(cached_array("textures", key, painted), dtype=np.uint8)
    return [
        flat[start:end].reshape(sizes[number][1], sizes[number][0], 3)
        for number, start, end in zip(numbers, starts[:-1], starts[1:], strict=True)
    ]


def _irradiance(world: World, light: int, lighting: lights.Lighting) -> list[Array]:
    """Light on all faces, from the cache if it is there."""
    sizes = baking.grid_sizes(world)
    key = _key(f"{world.digest} {light} {source_digest(_LIGHT_CODE)}")
    made = cached_array("light", key, lambda: baking.bake(world, lighting).astype(np.float16))
    ends = np.cumsum([rows * columns for rows, columns in sizes])
    parts = np.split(made.astype(np.float64), ends[:-1])
    return [part.reshape(*size, 3) for part, size in zip(parts, sizes, strict=True)]


def _key(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
