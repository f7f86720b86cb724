"""The sensor: exposure, gamma, noise and vignette have the sizes that were asked for."""

from __future__ import annotations

import numpy as np
import pytest
from covinz_agents.world.sensor import expose
from numpy.typing import NDArray

from covinz.scenario import Sensor

PERFECT = Sensor(shot_noise=0, read_noise=0, vignette=0, exposure_lag=0)


def radiance(seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng(seed).uniform(0.05, 0.6, (120, 160, 3)).astype(np.float32)


def picture(sensor: Sensor, light: NDArray[np.floating], seed: int = 0) -> NDArray[np.float64]:
    return expose(light, sensor, np.random.default_rng(seed)).astype(float)


@pytest.mark.parametrize("brightness", [0.01, 1.0, 30.0])
def test_the_mean_is_the_target_in_any_light(brightness: float) -> None:
    taken = picture(PERFECT, np.float32(brightness) * radiance())
    assert taken.mean() == pytest.approx(PERFECT.target_mean, abs=1.0)


def test_grey_levels_follow_gamma() -> None:
    light = np.full((64, 64, 3), 0.1, np.float32)
    light[32:] = 0.2
    taken = picture(PERFECT, light)
    assert taken[60, 5, 0] / taken[5, 5, 0] == pytest.approx(2 ** (1 / 2.2), rel=0.01)


def test_noise_has_the_deviation_that_was_asked_for() -> None:
    light = np.full((200, 200, 3), 0.2, np.float32)
    sensor = PERFECT.model_copy(update={"read_noise": 3.0, "shot_noise": 4.0})
    grey = sensor.target_mean / 255
    assert picture(sensor, light).std() == pytest.approx(np.sqrt(9 + 16 * grey), rel=0.03)


def test_the_vignette_darkens_corners_and_not_the_middle() -> None:
    light = np.full((121, 161, 3), 0.2, np.float32)
    taken = picture(PERFECT.model_copy(update={"vignette": 0.3}), light)
    loss = (taken[0, 0, 0] / taken[60, 80, 0]) ** 2.2
    assert loss == pytest.approx(0.7, abs=0.02)


def test_the_lag_of_the_exposure_is_in_stops() -> None:
    light = np.full((16, 16, 3), 0.2, np.float32)
    lagging = PERFECT.model_copy(update={"exposure_lag": 0.2})
    means = np.array([picture(lagging, light, seed)[0, 0, 0] for seed in range(300)])
    stops = 2.2 * np.log2(means / PERFECT.target_mean)
    assert stops.std() == pytest.approx(0.2, rel=0.15)
    assert abs(stops.mean()) < 0.05


def test_the_same_seed_gives_the_same_bits() -> None:
    first, again, other = (picture(Sensor(), radiance(), seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_several_images_are_averaged_as_light() -> None:
    dark, bright = np.full((8, 8, 3), 0.1, np.float32), np.full((8, 8, 3), 0.5, np.float32)
    blurred = picture(PERFECT, np.stack([dark, bright]))
    assert np.array_equal(blurred, picture(PERFECT, (dark + bright) / 2))
