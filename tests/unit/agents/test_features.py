"""Features cover the image, are reproducible and lie where the corners are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from covinz_agents.features import extract, extract_kinds
from covinz_agents.sift import root_sift
from numpy.typing import NDArray
from pydantic import ValidationError

from covinz.config import FeatureConfig
from covinz.types import FeatureType

CONFIG = FeatureConfig()
SIFT = FeatureConfig(kinds=("sift",))


def texture(seed: int = 1, height: int = 480, width: int = 640) -> NDArray[np.uint8]:
    """Blurred noise at several scales: corners everywhere and at every pyramid level."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width))
    for size in (4, 8, 16, 32):
        noise = rng.normal(size=(height // size, width // size))
        image += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    image = (image - image.min()) / np.ptp(image)
    return np.asarray(255 * image, dtype=np.uint8)


def occupied_cells(keypoints_px: NDArray[np.float32], shape: tuple[int, ...]) -> int:
    columns, rows = CONFIG.grid
    x = (keypoints_px[:, 0] * columns / shape[1]).astype(int)
    y = (keypoints_px[:, 1] * rows / shape[0]).astype(int)
    return len(set(zip(x.tolist(), y.tolist(), strict=True)))


def test_a_textured_image_gives_the_whole_number_in_every_cell() -> None:
    image = texture()
    features = extract(image, CONFIG)
    assert features.type is FeatureType.ORB
    assert len(features) == CONFIG.num_features
    assert occupied_cells(features.keypoints_px, image.shape) == 48


def test_the_number_is_a_limit_at_any_value() -> None:
    for number in (1, 7, 100, 5000):
        assert len(extract(texture(), FeatureConfig(num_features=number))) <= number


def test_a_strong_patch_does_not_take_the_features_of_the_rest() -> None:
    image = texture()
    weak = (image // 3 + 80).astype(np.uint8)
    weak[200:280, 280:360] = image[200:280, 280:360]
    covered = extract(weak, CONFIG)
    assert occupied_cells(covered.keypoints_px, weak.shape) >= 44
    in_patch = np.all(np.abs(covered.keypoints_px - [320, 240]) < 40, axis=1)
    assert in_patch.sum() < len(covered) / 2


def test_a_cell_without_strong_corners_uses_weak_ones() -> None:
    image = texture()
    dim = (image // 6).astype(np.uint8)
    image[:, :320] = dim[:, :320]
    left = extract(image, CONFIG).keypoints_px[:, 0] < 310
    strict = extract(image, FeatureConfig(min_fast_threshold=20)).keypoints_px[:, 0] < 310
    assert left.sum() > 20
    assert strict.sum() == 0


def test_the_same_pixels_give_the_same_bits() -> None:
    first, second = extract(texture(), CONFIG), extract(texture().copy(), CONFIG)
    assert first.keypoints_px.tobytes() == second.keypoints_px.tobytes()
    assert first.descriptors.tobytes() == second.descriptors.tobytes()


def test_positions_mirror_with_the_image_at_every_level() -> None:
    """A position is of the pixel's centre: no half-pixel shift may come from the pyramid."""
    image = texture()
    everything = FeatureConfig(num_features=2000)
    points = extract(image, everything).keypoints_px
    mirrored = extract(np.ascontiguousarray(image[:, ::-1]), everything).keypoints_px
    mirrored = mirrored * [-1, 1] + [image.shape[1] - 1, 0]
    nearest = np.array([np.abs(mirrored - p).max(axis=1).min() for p in points])
    assert np.median(nearest) < 1e-3
    assert np.mean(nearest < 1e-2) > 0.9  # the rest: ties at the limit of the number


def test_colour_and_grey_agree() -> None:
    grey = texture()
    colour = np.repeat(grey[:, :, None], 3, axis=2)
    assert np.array_equal(extract(grey, CONFIG).descriptors, extract(colour, CONFIG).descriptors)


def test_an_image_without_corners_has_no_features() -> None:
    features = extract(np.full((480, 640), 90, np.uint8), CONFIG)
    assert len(features) == 0
    assert features.descriptors.shape == (0, 32)


@pytest.mark.parametrize(
    "image", [np.zeros((480, 640), np.float32), np.zeros((480, 640, 4), np.uint8)]
)
def test_other_images_are_refused(image: NDArray[np.uint8]) -> None:
    with pytest.raises(ValueError, match="expected an image"):
        extract(image, CONFIG)


def test_sift_covers_the_image_too() -> None:
    image = texture()
    features = extract(image, SIFT)
    assert features.type is FeatureType.SIFT
    assert len(features) == SIFT.sift.num_features
    assert occupied_cells(features.keypoints_px, image.shape) == 48
    again = extract(image.copy(), SIFT)
    assert features.keypoints_px.tobytes() == again.keypoints_px.tobytes()
    assert features.descriptors.tobytes() == again.descriptors.tobytes()


def test_sift_on_a_weak_half_uses_the_lower_threshold() -> None:
    image = texture()
    image[:, :320] = (image // 5)[:, :320]
    strict = {"kinds": ["sift"], "sift": {"min_contrast_threshold": 0.04}}
    counts = [
        int((extract(image, config).keypoints_px[:, 0] < 300).sum())
        for config in (SIFT, FeatureConfig.model_validate(strict))
    ]
    assert counts[0] > 50
    assert counts[1] < 10


def test_sift_positions_mirror_with_the_image() -> None:
    """Without the precise enlargement they would be half a pixel apart."""
    image = texture()
    everything = FeatureConfig.model_validate({"kinds": ["sift"], "sift": {"num_features": 5000}})
    points = extract(image, everything).keypoints_px
    mirrored = extract(np.ascontiguousarray(image[:, ::-1]), everything).keypoints_px
    mirrored = mirrored * [-1, 1] + [image.shape[1] - 1, 0]
    nearest = np.array([np.abs(mirrored - p).max(axis=1).min() for p in points])
    assert np.median(nearest) < 0.05


def test_sift_descriptors_match_across_scale_and_turn() -> None:
    """Half the size and turned by 30 degrees: matched points lie where the image was mapped to."""
    image = texture()
    warp = cv2.getRotationMatrix2D((320, 240), 30, 0.5)
    small = np.asarray(cv2.warpAffine(image, warp, (640, 480)), np.uint8)
    first, second = extract(image, SIFT), extract(small, SIFT)
    a, b = first.descriptors.astype(np.int32), second.descriptors.astype(np.int32)
    squared = (a**2).sum(1)[:, None] + (b**2).sum(1)[None] - 2 * a @ b.T
    nearest, two = squared.argmin(axis=1), np.sort(squared, axis=1)[:, :2]
    matched = two[:, 0] < 0.64 * two[:, 1]
    expected = first.keypoints_px @ warp[:, :2].T + warp[:, 2]
    error_px = np.linalg.norm(second.keypoints_px[nearest] - expected, axis=1)[matched]
    assert matched.sum() > 100
    assert np.mean(error_px < 1.0) > 0.9


def test_root_sift_bytes_keep_the_hellinger_distance() -> None:
    rng = np.random.default_rng(3)
    histograms = rng.gamma(0.5, size=(50, 128)).astype(np.float32)
    exact = np.sqrt(histograms / histograms.sum(axis=1, keepdims=True))
    found = root_sift(histograms)
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, root_sift(1000 * histograms))
    np.testing.assert_allclose(np.linalg.norm(found.astype(float), axis=1), 512, atol=4)
    apart = np.linalg.norm(found[0].astype(float) - found[1:], axis=1)
    true = 512 * np.linalg.norm(exact[0] - exact[1:], axis=1)
    np.testing.assert_allclose(apart, true, atol=4)


def test_root_sift_saturates_and_takes_an_empty_histogram() -> None:
    peak = np.zeros((2, 128), np.float32)
    peak[0, 7] = 512.0
    found = root_sift(peak)
    assert (found[0, 7], found.sum()) == (255, 255)


def test_kinds_come_in_the_order_asked_for() -> None:
    image = texture()
    both = extract_kinds(image, FeatureConfig(kinds=("sift", "orb")))
    assert [features.type for features in both] == [FeatureType.SIFT, FeatureType.ORB]
    for features, config in zip(both, (SIFT, CONFIG), strict=True):
        (alone,) = extract_kinds(image, config)
        assert np.array_equal(features.descriptors, alone.descriptors)


def test_an_image_without_points_has_no_sift() -> None:
    features = extract(np.full((480, 640), 90, np.uint8), SIFT)
    assert features.descriptors.shape == (0, 128)


@pytest.mark.parametrize(
    ("written", "kinds"),
    [("sift", ("sift",)), (["orb", "sift"], ("orb", "sift")), ({"kinds": ["sift"]}, ("sift",))],
)
def test_a_scenario_may_only_name_the_kinds(written: object, kinds: tuple[str, ...]) -> None:
    assert FeatureConfig.model_validate(written).kinds == kinds


@pytest.mark.parametrize("written", ["surf", [], ["orb", "orb"], {"kinds": []}])
def test_other_kinds_are_refused(written: object) -> None:
    with pytest.raises(ValidationError):
        FeatureConfig.model_validate(written)
