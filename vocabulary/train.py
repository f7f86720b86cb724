"""Train the vocabulary that ships with the repository: `make vocabulary`.

ORB features, extracted as the agents extract them, of recorded images whose licence allows it
and of generated textures; no image of the benchmark scenes. (README.md says what was chosen by
their recall.) Writes `orb_10k.bin` and beside it `provenance.json`: from what and how.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import covinz_core as core
import cv2
import numpy as np
from covinz_agents.features import extract
from numpy.typing import NDArray

from covinz.config import FeatureConfig
from vocabulary.textures import draw_texture

_HERE = Path(__file__).resolve().parent
_DEFAULT_DATA = _HERE.parents[1] / "shared" / "data"

# As many images as the recording has, twice: a room is not the world.
_NUM_TEXTURES = 480
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


def train(images: Iterator[NDArray[np.uint8]], **options: int) -> tuple[core.Vocabulary, list[int]]:
    """Train a vocabulary; returns it with the number of descriptors of each image.

    Args:
        images: Grey images, (H, W) uint8.
        options: Of `covinz_core.Vocabulary.train`.
    """
    features = FeatureConfig()
    descriptors = [extract(image, features).descriptors for image in images]
    counts = [len(block) for block in descriptors]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return core.Vocabulary.train(np.concatenate(descriptors), offsets, **options), counts


def provenance(vocabulary: core.Vocabulary, counts: list[int], num_recorded: int) -> dict[str, Any]:
    """What the vocabulary was made from and how, for `provenance.json`."""
    return {
        "file": "orb_10k.bin",
        "vocabulary_hash": vocabulary.hash,
        "sha256": hashlib.sha256(vocabulary.to_bytes()).hexdigest(),
        "num_words": vocabulary.num_words,
        "command": "make vocabulary",
        "training": _TRAINING,
        "features": FeatureConfig().model_dump(mode="json"),
        "versions": {"opencv": cv2.__version__, "numpy": np.__version__},
        "sources": [
            {
                "name": "TUM RGB-D benchmark, freiburg1_rpy, colour images",
                "url": "https://cvg.cit.tum.de/data/datasets/rgbd-dataset",
                "licence": "CC BY 4.0",
                "attribution": "J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers: A "
                "Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012",
                "images": num_recorded,
                "descriptors": sum(counts[:num_recorded]),
            },
            {
                "name": "Generated textures, vocabulary/textures.py",
                "licence": "Apache-2.0",
                "attribution": "covinz",
                "images": len(counts) - num_recorded,
                "descriptors": sum(counts[num_recorded:]),
            },
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
        vocabulary, counts = train(training_images(recording, _NUM_TEXTURES), **_TRAINING)
    except FileNotFoundError as error:
        print(f"The recording to train on is not at hand: {error}", file=sys.stderr)
        return 1
    (arguments.out / "orb_10k.bin").write_bytes(vocabulary.to_bytes())
    record = provenance(vocabulary, counts, len(counts) - _NUM_TEXTURES)
    (arguments.out / "provenance.json").write_text(json.dumps(record, indent=2) + "\n")
    print(f"{vocabulary.num_words} words, {vocabulary.hash}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
