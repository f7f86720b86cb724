"""Train the vocabularies that ship with the repository, one for each kind: `make vocabulary`.

Features, extracted as the agents extract them, of recorded images whose licence allows it and of
generated textures; no image of the benchmark scenes. (README.md says what was chosen by their
recall.) Writes `orb_10k.bin`, `sift_10k.bin` and beside them `provenance.json`: from what and how.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import covinz_core as core
import cv2
import numpy as np
from covinz_agents.features import extract_kinds
from numpy.typing import NDArray

from covinz.config import FeatureConfig, FeatureKind
from vocabulary.textures import draw_texture

_HERE = Path(__file__).resolve().parent
_DEFAULT_DATA = _HERE.parents[1] / "shared" / "data"

# As many images as the recording has, twice: a room is not the world.
_NUM_TEXTURES = 480
FILES: dict[FeatureKind, str] = {"orb": "orb_10k.bin", "sift": "sift_10k.bin"}
# The shape of DBoW2 and the seed 0, decided before any recall was measured.
_TRAINING = {"branching": 10, "depth": 4, "seed": 0, "max_iterations": 25}


def recorded_images(folder: Path) -> Iterator[NDArray[np.uint8]]:
    """Grey images of a TUM RGB-D recording in the order of their time stamps.

    Raises:
        FileNotFoundError: If the recording or one of its images is missing.
    """
    listing = (folder / "rgb.txt").read_text().splitlines()
    for line in listing:
        if line.strip() and not line.startswith("#"):
            path = folder / line.split()[1]
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if image is None:
                raise FileNotFoundError(f"cannot read {path}")
            yield np.asarray(image, dtype=np.uint8)


def training_images(recording: Path, num_textures: int) -> Iterator[NDArray[np.uint8]]:
    """The recorded images, then textures of seeds 0, 1, 2, ..."""
    yield from recorded_images(recording)
    for seed in range(num_textures):
        yield draw_texture(seed)


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """A vocabulary of one kind of feature.

    Attributes:
        vocabulary: What was trained.
        counts: Number of descriptors of each image.
    """

    vocabulary: core.Vocabulary | core.ByteVocabulary
    counts: list[int]


def features_of(kind: FeatureKind) -> FeatureConfig:
    """How the features of one kind are extracted: as by default."""
    return FeatureConfig(kinds=(kind,))


def train(images: Iterator[NDArray[np.uint8]], **options: int) -> dict[FeatureKind, Trained]:
    """Train one vocabulary for each kind of feature.

    Args:
        images: Grey images, (H, W) uint8.
        options: Of `covinz_core.Vocabulary.train`.
    """
    config = FeatureConfig(kinds=tuple(FILES))
    descriptors: dict[FeatureKind, list[NDArray[np.uint8]]] = {kind: [] for kind in FILES}
    for image in images:
        for kind, features in zip(FILES, extract_kinds(image, config), strict=True):
            descriptors[kind].append(features.descriptors)
    return {kind: _trained(kind, blocks, options) for kind, blocks in descriptors.items()}


def _trained(
    kind: FeatureKind, descriptors: list[NDArray[np.uint8]], options: dict[str, int]
) -> Trained:
    counts = [len(block) for block in descriptors]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    of_kind = core.Vocabulary if kind == "orb" else core.ByteVocabulary
    return Trained(of_kind.train(np.concatenate(descriptors), offsets, **options), counts)


def provenance(trained: dict[FeatureKind, Trained], num_recorded: int) -> dict[str, Any]:
    """What the vocabularies were made from and how, for `provenance.json`."""
    num_images = len(next(iter(trained.values())).counts)

    def source(part: slice, **origin: str) -> dict[str, Any]:
        counts = {kind: sum(one.counts[part]) for kind, one in trained.items()}
        return {**origin, "images": len(range(num_images)[part]), "descriptors": counts}

    return {
        "command": "make vocabulary",
        "training": _TRAINING,
        "versions": {"opencv": cv2.__version__, "numpy": np.__version__},
        "vocabularies": {
            kind: {
                "file": FILES[kind],
                "vocabulary_hash": one.vocabulary.hash,
                "sha256": hashlib.sha256(one.vocabulary.to_bytes()).hexdigest(),
                "num_words": one.vocabulary.num_words,
                "features": features_of(kind).model_dump(mode="json"),
            }
            for kind, one in trained.items()
        },
        "sources": [
            source(
                slice(num_recorded),
                name="TUM RGB-D benchmark, freiburg1_rpy, colour images",
                url="https://cvg.cit.tum.de/data/datasets/rgbd-dataset",
                licence="CC BY 4.0",
                attribution="J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers: A "
                "Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012",
            ),
            source(
                slice(num_recorded, None),
                name="Generated textures, vocabulary/textures.py",
                licence="Apache-2.0",
                attribution="covinz",
            ),
        ],
    }


def main() -> int:
    """Train and write the files; 1 if the recording is not at hand."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    data = Path(os.environ.get("COVINZ_DATA", _DEFAULT_DATA))
    parser.add_argument("--data", type=Path, default=data, help="folder that holds fr1_rpy/")
    parser.add_argument("--out", type=Path, default=_HERE, help="folder to write to")
    arguments = parser.parse_args()
    recording = arguments.data / "fr1_rpy"
    try:
        trained = train(training_images(recording, _NUM_TEXTURES), **_TRAINING)
    except FileNotFoundError as error:
        print(f"The recording to train on is not at hand: {error}", file=sys.stderr)
        return 1
    for kind, one in trained.items():
        (arguments.out / FILES[kind]).write_bytes(one.vocabulary.to_bytes())
        print(f"{kind}: {one.vocabulary.num_words} words, {one.vocabulary.hash}")
    record = provenance(trained, len(trained["orb"].counts) - _NUM_TEXTURES)
    (arguments.out / "provenance.json").write_text(json.dumps(record, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
