"""Random fields for textures: structure at many scales, as natural surfaces have it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float32]
Colour = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A piece of surface to be painted.

    Attributes:
        rng: Source of everything random in it.
        width_px: Size of its texture.
        height_px:
        width_m: Size of the surface.
        height_m:
    """

    rng: np.random.Generator
    width_px: int
    height_px: int
    width_m: float
    height_m: float

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.height_px, self.width_px

    @property
    def x_px_per_m(self) -> float:
        """Texture columns per metre."""
        return self.width_px / self.width_m

    @property
    def y_px_per_m(self) -> float:
        """Texture rows per metre."""
        return self.height_px / self.height_m

    @property
    def px_per_m(self) -> float:
        """Texture pixels per metre, about the same along both axes."""
        return float(np.sqrt(self.x_px_per_m * self.y_px_per_m))

    def flat(self, bgr: Colour) -> Field:
        """(H, W, 3) one colour, 0 to 255."""
        return np.full((*self.shape, 3), bgr, dtype=np.float32)

    def pick(self, *options: Colour) -> Colour:
        """One of several colours."""
        return options[int(self.rng.integers(len(options)))]


def lattice(patch: Patch, cell_x_m: float, cell_y_m: float) -> Field:
    """(H, W) smooth noise of mean 0 and deviation about 1, with cells of a size."""
    columns = max(patch.width_m / cell_x_m, 0.5)
    rows = max(patch.height_m / cell_y_m, 0.5)
    # A lattice is drawn with a border so that the noise does not end flat at the edges.
    size = int(np.ceil(rows)) + 4, int(np.ceil(columns)) + 4
    values = patch.rng.standard_normal(size, dtype=np.float32)
    step_x, step_y = columns / patch.width_px, rows / patch.height_px
    start = patch.rng.uniform(1.0, 2.0, 2)
    take = np.array([[step_x, 0, start[0]], [0, step_y, start[1]]])
    smooth = cv2.warpAffine(
        values,
        take,
        (patch.width_px, patch.height_px),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    return np.asarray(1.4 * smooth, dtype=np.float32)


def fractal(
    patch: Patch,
    coarsest_m: float,
    finest_m: float,
    *,
    gain: float = 0.7,
    stretch: float = 1.0,
) -> Field:
    """(H, W) noise summed over octaves of cell size, mean 0 and deviation about 1.

    Args:
        patch: Where.
        coarsest_m: Largest cells.
        finest_m: Smallest cells; none are smaller than two pixels.
        gain: Weight of an octave relative to the next coarser one.
        stretch: How many times longer cells are along y than along x.
    """
    total = np.zeros(patch.shape, dtype=np.float32)
    weight, power, cell = 1.0, 0.0, coarsest_m
    while cell >= max(finest_m, 2 / patch.px_per_m) or power == 0.0:
        total += np.float32(weight) * lattice(patch, cell, cell * stretch)
        power += weight**2
        weight *= gain
        cell /= 2
    total /= np.float32(np.sqrt(power))
    return total


def grain(patch: Patch) -> Field:
    """(H, W) noise of single pixels, mean 0 and deviation 1."""
    return patch.rng.standard_normal(patch.shape, dtype=np.float32)


def shade(image: Field, by: Field) -> None:
    """Multiply an image (H, W, 3) by 1 + a field (H, W)."""
    image *= (1 + by)[..., None]


def blend(image: Field, bgr: Colour, share: Field) -> None:
    """Mix a colour into an image (H, W, 3) by a share (H, W) of 0 to 1."""
    image += (np.array(bgr, dtype=np.float32) - image) * np.clip(share, 0, 1)[..., None]


def blotches(patch: Patch, size_m: float, cover: float, softness: float = 0.3) -> Field:
    """(H, W) irregular spots: 1 in them, 0 outside, on about a share of the surface."""
    field = fractal(patch, size_m, size_m / 8, gain=0.6)
    level = np.float32(np.quantile(field[::4, ::4], 1 - cover))
    return np.asarray(np.clip((field - level) / np.float32(softness), 0, 1), dtype=np.float32)


def mask(patch: Patch) -> NDArray[np.uint8]:
    """(H, W) an empty mask to draw shapes of 255 into."""
    return np.zeros(patch.shape, dtype=np.uint8)


def finished(image: Field) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 of an image of 0 to 255."""
    return np.asarray(np.clip(image + np.float32(0.5), 0, 255), dtype=np.uint8)
