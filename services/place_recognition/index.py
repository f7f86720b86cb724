"""The image index: binary words of a vocabulary, ranked by verified votes or by tf-idf."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import covinz_core
import numpy as np
from numpy.typing import NDArray

from covinz.config import ConfigError, PlaceRecognitionConfig

Words = NDArray[np.uint32]
Descriptors = NDArray[np.uint8]

CHECKOUT = Path(__file__).resolve().parents[2]


class Vocabulary(Protocol):
    """Quantises descriptors; `covinz_core.Vocabulary` is one."""

    @property
    def hash(self) -> str:
        """Identity of the content."""

    def words(self, descriptors: Descriptors) -> Words:
        """The word (N,) of every descriptor (N, 32)."""


class PlaceIndex(Protocol):
    """Scores keyframes; slot i is the i-th one added."""

    def add(self, words: Words, descriptors: Descriptors) -> int:
        """Put a keyframe in and return its slot."""

    def scores(self, words: Words, descriptors: Descriptors) -> NDArray[np.float32]:
        """Score (size,) of every keyframe in the index for a query; higher is more alike."""


class VoteIndex:
    """Verified votes: descriptors of one word vote for each other when they are alike.

    Source: decision 0004.
    """

    def __init__(self, max_hamming: int) -> None:
        self._index = covinz_core.InvertedIndex(max_hamming)

    def add(self, words: Words, descriptors: Descriptors) -> int:
        """Put a keyframe in and return its slot."""
        return int(self._index.add(words, descriptors))

    def scores(self, words: Words, descriptors: Descriptors) -> NDArray[np.float32]:
        """Idf-weighted votes (size,)."""
        votes: NDArray[np.float32] = self._index.votes(words, descriptors)
        return votes


class TfIdfIndex:
    """The paper's bag-of-words score in [0, 1].

    Source: Galvez-Lopez and Tardos, "Bags of binary words for fast place recognition in image
    sequences", T-RO 2012; COVINS-G III-B1.
    """

    def __init__(self, vocabulary: covinz_core.Vocabulary) -> None:
        self._index = covinz_core.TfIdfIndex(vocabulary)

    def add(self, words: Words, descriptors: Descriptors) -> int:
        """Put a keyframe in and return its slot."""
        return int(self._index.add(words))

    def scores(self, words: Words, descriptors: Descriptors) -> NDArray[np.float32]:
        """L1 similarity (size,) of the tf-idf vectors."""
        scores: NDArray[np.float32] = self._index.scores(words)
        return scores


def load_vocabulary(path: Path) -> covinz_core.Vocabulary:
    """Read a vocabulary file; a relative path counts from the checkout.

    Raises:
        ConfigError: If the file is missing or is no vocabulary.
    """
    try:
        return covinz_core.Vocabulary.from_bytes((CHECKOUT / path).read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot use the vocabulary {path}: {error}") from error


def new_index(config: PlaceRecognitionConfig, vocabulary: covinz_core.Vocabulary) -> PlaceIndex:
    """An empty index that scores as configured.

    Raises:
        ConfigError: If no score could ever pass the threshold.
    """
    if config.score == "votes":
        return VoteIndex(config.max_hamming)
    if config.min_score > 1:
        raise ConfigError(
            f"place_recognition.min_score is {config.min_score}, but tf_idf scores are at most 1"
        )
    return TfIdfIndex(vocabulary)
