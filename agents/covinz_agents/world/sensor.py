"""What a camera's sensor makes of the light that falls on it."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covinz.scenario.scenes import Sensor

# Radiance to grey level: the exponent of ordinary displays and cameras.
_GAMMA = 1 / 2.2
# The exposure is set by every so many pixels along each axis.
_METERING_STEP = 4
_METERING_ROUNDS = 16
# Exposures that are tried, as log2 of the gain. [stops]
_GAIN_STOPS = (-10.0, 10.0)


def expose(
    images: NDArray[np.float32] | Sequence[NDArray[np.float32]],
    sensor: Sensor,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """The picture that a camera records.

    Args:
        images: (H, W, 3) linear radiance, or several over the time of exposure, which are
            averaged: motion blur.
        sensor: Noise, vignette and exposure.
        rng: Of the noise and of the lag of the exposure; consumed by it.

    Returns:
        (H, W, 3) uint8 BGR.
    """
    stack = np.asarray(images, dtype=np.float32)
    light = stack.mean(axis=0) if stack.ndim == 4 else stack
    height, width = light.shape[:2]
    light = light * _vignette(height, width, sensor.vignette)[..., None]
    stops = _metered_stops(light, sensor.target_mean) + sensor.exposure_lag * rng.normal()
    grey = np.clip(light * np.float32(2.0**stops), 0, 1) ** np.float32(_GAMMA)
    variance = grey * np.float32(sensor.shot_noise**2) + np.float32(sensor.read_noise**2)
    noise = rng.standard_normal(grey.shape, dtype=np.float32)
    noise *= np.sqrt(variance)
    return np.asarray(np.clip(255 * grey + noise + 0.5, 0, 255), dtype=np.uint8)


def _metered_stops(light: NDArray[np.float32], target_mean: float) -> float:
    """log2 of the gain at which the mean grey level is the target."""
    metered = light[::_METERING_STEP, ::_METERING_STEP]
    low, high = _GAIN_STOPS
    for _ in range(_METERING_ROUNDS):
        middle = (low + high) / 2
        grey = np.clip(metered * np.float32(2.0**middle), 0, 1) ** np.float32(_GAMMA)
        if 255 * float(grey.mean(dtype=np.float64)) < target_mean:
            low = middle
        else:
            high = middle
    return (low + high) / 2


@functools.lru_cache(maxsize=4)
def _vignette(height: int, width: int, loss: float) -> NDArray[np.float32]:
    """(H, W) share of light that reaches a pixel: falls to 1 - loss in the corners."""
    x = np.linspace(-1, 1, width, dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)
    return np.asarray(1 - loss * (x**2 + y[:, None] ** 2) / 2, dtype=np.float32)
