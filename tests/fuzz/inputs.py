"""Inputs of the fuzzer: the good messages it begins with, and the corpus that it leaves.

The corpus is one zip file a message type. It has one input, the shortest that was found, for each
place where reading ended; so it is what the fuzzer knows, without its hours.
"""

from __future__ import annotations

import dataclasses
import hashlib
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from covinz import codec
from covinz.types import Features, FeatureType
from tests.contract.examples import KEYFRAME

CORPUS = Path(__file__).parent / "corpus"
GOLDEN = Path(__file__).parents[1] / "contract" / "golden"
# Every entry has this time, so that the same inputs are the same file.
_TIME = (1980, 1, 1, 0, 0, 0)


def good_messages() -> Iterator[tuple[str, bytes]]:
    """The golden messages, and a keyframe as large as robots send; with the names of their types.

    Sorted, so that a seed of the fuzzer means the same everywhere.
    """
    for file in sorted(GOLDEN.glob("*.bin")):
        yield file.stem.split("-")[0], file.read_bytes()
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, (640, 480), (1000, 2)).astype(np.float32)
    descriptors = rng.integers(0, 256, (1000, 32), dtype=np.uint8)
    features = Features(FeatureType.ORB, pixels, descriptors)
    yield "Keyframe", codec.encode(dataclasses.replace(KEYFRAME, features=features))


def read_corpus(folder: Path = CORPUS) -> dict[str, list[bytes]]:
    """The inputs by the name of the message that is expected."""
    found = {}
    for file in sorted(folder.glob("*.zip")):
        with zipfile.ZipFile(file) as archive:
            found[file.stem] = [archive.read(name) for name in sorted(archive.namelist())]
    return found


def write_corpus(folder: Path, inputs: Mapping[str, Iterable[bytes]]) -> None:
    """Write the inputs in place of those that were there."""
    folder.mkdir(parents=True, exist_ok=True)
    for message, payloads in inputs.items():
        named = {hashlib.blake2b(p, digest_size=8).hexdigest(): p for p in payloads}
        with zipfile.ZipFile(folder / f"{message}.zip", "w") as archive:
            for name in sorted(named):
                entry = zipfile.ZipInfo(name, _TIME)
                archive.writestr(entry, named[name], zipfile.ZIP_DEFLATED)
