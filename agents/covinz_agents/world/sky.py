"""The sky over a world: colours by the light of a visit, and clouds."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Bgr = tuple[float, float, float]

_CLOUDS_PX = 512
_MIDDLE = slice(_CLOUDS_PX, 2 * _CLOUDS_PX)


@dataclass(frozen=True, slots=True, eq=False)
class Sky:
    """What is seen beyond all faces; BGR radiance.

    Attributes:
        zenith: Straight up.
        horizon: At and below the horizon.
        cloud: Of clouds.
        clouds: (H, W) uint8 cover, tileable.
    """

    zenith: Bgr
    horizon: Bgr
    cloud: Bgr
    clouds: NDArray[np.uint8]


def sky(seed: int, light: int) -> Sky:
    """The sky of a light; black lies behind the walls of a hall, where nobody sees it."""
    rng = np.random.default_rng([seed, light, 0x44])
    cover = 0.35 if light == 0 else float(rng.uniform(0.1, 0.9))
    field = _tileable(rng)
    level = np.quantile(field, 1 - cover)
    clouds = np.clip(110 * (field - level), 0, 230).astype(np.uint8)
    return Sky((0.62, 0.42, 0.26), (0.86, 0.80, 0.72), (0.95, 0.95, 0.95), clouds)


def _tileable(rng: np.random.Generator) -> NDArray[np.float32]:
    """Noise over octaves that continues at the opposite edge."""
    total = np.zeros((_CLOUDS_PX, _CLOUDS_PX), dtype=np.float32)
    for octave, cells in enumerate((4, 8, 16, 32, 64)):
        values = rng.standard_normal((cells, cells), dtype=np.float32)
        # Three times the tile, of which the middle is taken.
        size = 3 * _CLOUDS_PX, 3 * _CLOUDS_PX
        wide = cv2.resize(np.tile(values, (3, 3)), size, interpolation=cv2.INTER_CUBIC)
        total += np.float32(0.6**octave) * wide[_MIDDLE, _MIDDLE]
    return total
