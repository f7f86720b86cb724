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
    finest = max(finest_m, 2 / (patch.px_per_m * min(1.0, stretch)))
    octaves = 1 + max(0, int(np.floor(np.log2(coarsest_m / finest))))
    total: Field | None = None
    for octave in range(octaves):
        cell_m = coarsest_m / 2**octave
        # Coarse octaves are added up in small images: the last one alone has all the pixels.
        cell_px = cell_m * patch.px_per_m * min(1.0, stretch)
        coarser = 1 if octave == octaves - 1 else max(1, int(cell_px / 4))
        size = -(-patch.width_px // coarser), -(-patch.height_px // coarser)
        noise = _lattice(patch, cell_m, cell_m * stretch, size)
        if total is not None:
            noise *= np.float32(gain**octave)
            noise += cv2.resize(total, size, interpolation=cv2.INTER_LINEAR)
        total = noise
    assert total is not None
    power = sum(gain ** (2 * octave) for octave in range(octaves))
    return np.asarray(total / np.float32(np.sqrt(power)), dtype=np.float32)


def _lattice(patch: Patch, cell_x_m: float, cell_y_m: float, size: tuple[int, int]) -> Field:
    """Smooth noise of deviation about 1 with cells of a size, as an image (width, height)."""
    columns = max(patch.width_m / cell_x_m, 0.5)
    rows = max(patch.height_m / cell_y_m, 0.5)
    # A border keeps the noise from ending flat at the edges.
    cells = int(np.ceil(rows)) + 4, int(np.ceil(columns)) + 4
    values = patch.rng.standard_normal(cells, dtype=np.float32)
    start = patch.rng.uniform(1.0, 2.0, 2)
    take = np.array([[columns / size[0], 0, start[0]], [0, rows / size[1], start[1]]])
    smooth = cv2.warpAffine(
        values,
        take,
        size,
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    return np.asarray(1.4 * smooth, dtype=np.float32)


def grain(patch: Patch) -> Field:
    """(H, W) noise of single pixels, mean 0 and deviation 1."""
    return patch.rng.standard_normal(patch.shape, dtype=np.float32)


def shade(image: Field, by: NDArray[np.floating]) -> None:
    """Multiply an image (H, W, 3) by 1 + a field (H, W)."""
    image *= (1 + np.asarray(by, dtype=np.float32))[..., None]


def blend(image: Field, bgr: Colour, share: NDArray[np.floating]) -> None:
    """Mix a colour into an image (H, W, 3) by a share (H, W) of 0 to 1."""
    part = np.clip(share, 0, 1).astype(np.float32)[..., None]
    image *= 1 - part
    image += np.array(bgr, dtype=np.float32) * part


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
