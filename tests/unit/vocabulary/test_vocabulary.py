"""The shipped vocabulary and how it is made."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import covinz_core as core
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from covinz.config import FeatureConfig, PlaceRecognitionConfig
from vocabulary.textures import draw_texture
from vocabulary.train import recorded_images, train

REPOSITORY = Path(__file__).resolve().parents[3]
FOLDER = REPOSITORY / "vocabulary"


def textures() -> Iterator[NDArray[np.uint8]]:
    yield from (draw_texture(seed) for seed in range(5))


def test_shipped_file_is_the_one_its_provenance_describes() -> None:
    data = (REPOSITORY / PlaceRecognitionConfig().vocabulary).read_bytes()
    provenance = json.loads((FOLDER / "provenance.json").read_text())
    vocabulary = core.Vocabulary.from_bytes(data)
    assert vocabulary.hash == provenance["vocabulary_hash"]
    assert hashlib.sha256(data).hexdigest() == provenance["sha256"]
    assert vocabulary.num_words == provenance["num_words"] == 10_000
    assert len(data) <= 10e6
    assert all(source["licence"] in ("CC BY 4.0", "Apache-2.0") for source in provenance["sources"])


def test_shipped_file_was_trained_on_the_features_that_agents_extract() -> None:
    provenance = json.loads((FOLDER / "provenance.json").read_text())
    assert provenance["features"] == FeatureConfig().model_dump(mode="json")


def test_textures_depend_on_their_seed_alone() -> None:
    first = [draw_texture(seed) for seed in range(5)]
    again = [draw_texture(seed) for seed in reversed(range(5))][::-1]
    for image, same in zip(first, again, strict=True):
        assert image.shape == (480, 640)
        assert image.dtype == np.uint8
        assert image.std() > 5
        np.testing.assert_array_equal(image, same)
    assert not np.array_equal(first[0], draw_texture(5))


def test_training_is_reproducible() -> None:
    options = {"branching": 4, "depth": 3, "seed": 1}
    first, counts = train(textures(), **options)
    second, _ = train(textures(), **options)
    assert first.to_bytes() == second.to_bytes()
    assert first.num_words == 64
    assert len(counts) == 5
    assert sum(counts) > 4000


def test_recorded_images_come_in_the_order_of_the_listing(tmp_path: Path) -> None:
    for name, shade in (("b", 10), ("a", 20)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((4, 5), shade, np.uint8))
    (tmp_path / "rgb.txt").write_text("# stamp file\n1.0 b.png\n2.0 a.png\n")
    assert [int(image[0, 0]) for image in recorded_images(tmp_path)] == [10, 20]


def test_missing_image_is_named(tmp_path: Path) -> None:
    (tmp_path / "rgb.txt").write_text("1.0 none.png\n")
    with pytest.raises(FileNotFoundError, match=r"none\.png"):
        list(recorded_images(tmp_path))
