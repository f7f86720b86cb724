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

from covinz.config import FeatureConfig, FeatureKind, PlaceRecognitionConfig
from vocabulary.textures import draw_texture
from vocabulary.train import recorded_images, train

REPOSITORY = Path(__file__).resolve().parents[3]
FOLDER = REPOSITORY / "vocabulary"


def textures() -> Iterator[NDArray[np.uint8]]:
    yield from (draw_texture(seed) for seed in range(5))


PROVENANCE = json.loads((FOLDER / "provenance.json").read_text())
CONFIG = PlaceRecognitionConfig()
SHIPPED: dict[str, tuple[Path, type[core.Vocabulary] | type[core.ByteVocabulary]]] = {
    "orb": (CONFIG.vocabulary, core.Vocabulary),
    "sift": (CONFIG.sift.vocabulary, core.ByteVocabulary),
}


@pytest.mark.parametrize("kind", SHIPPED)
def test_shipped_file_is_the_one_its_provenance_describes(kind: str) -> None:
    path, of_kind = SHIPPED[kind]
    data = (REPOSITORY / path).read_bytes()
    described = PROVENANCE["vocabularies"][kind]
    vocabulary = of_kind.from_bytes(data)
    assert described["file"] == path.name
    assert vocabulary.hash == described["vocabulary_hash"]
    assert hashlib.sha256(data).hexdigest() == described["sha256"]
    assert vocabulary.num_words == described["num_words"] == 10_000
    assert len(data) <= 2e6


def test_sources_may_be_used() -> None:
    assert all(source["licence"] in ("CC BY 4.0", "Apache-2.0") for source in PROVENANCE["sources"])


@pytest.mark.parametrize("kind", SHIPPED)
def test_shipped_file_was_trained_on_the_features_that_agents_extract(kind: FeatureKind) -> None:
    described = PROVENANCE["vocabularies"][kind]
    assert described["features"] == FeatureConfig(kinds=(kind,)).model_dump(mode="json")


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
    first, second = train(textures(), **options), train(textures(), **options)
    assert set(first) == {"orb", "sift"}
    for kind, trained in first.items():
        assert trained.vocabulary.to_bytes() == second[kind].vocabulary.to_bytes()
        assert trained.vocabulary.num_words == 64
        assert len(trained.counts) == 5
        assert sum(trained.counts) > 2500


def test_recorded_images_come_in_the_order_of_the_listing(tmp_path: Path) -> None:
    for name, shade in (("b", 10), ("a", 20)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((4, 5), shade, np.uint8))
    (tmp_path / "rgb.txt").write_text("# stamp file\n1.0 b.png\n2.0 a.png\n")
    assert [int(image[0, 0]) for image in recorded_images(tmp_path)] == [10, 20]


def test_missing_image_is_named(tmp_path: Path) -> None:
    (tmp_path / "rgb.txt").write_text("1.0 none.png\n")
    with pytest.raises(FileNotFoundError, match=r"none\.png"):
        list(recorded_images(tmp_path))
