"""Index of one kind of feature: words of a vocabulary, ranked by verified votes or by tf-idf."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import covinz_core
import numpy as np
from numpy.typing import NDArray

from covinz.config import ConfigError, FeatureKind, PlaceRecognitionConfig

Words = NDArray[np.uint32]
Descriptors = NDArray[np.uint8]

CoreVocabulary = covinz_core.Vocabulary | covinz_core.ByteVocabulary

CHECKOUT = Path(__file__).resolve().parents[2]


class Vocabulary(Protocol):
    """Quantises descriptors; `covinz_core.Vocabulary` and `ByteVocabulary` are."""

    @property
    def hash(self) -> str:
        """Identity of the content."""

    def words(self, descriptors: Descriptors) -> Words:
        """The word (N,) of every descriptor (N, B)."""


class PlaceIndex(Protocol):
    """Scores keyframes; slot i is the i-th one added."""

    def add(self, words: Words, descriptors: Descriptors) -> int:
        """Put a keyframe in and return its slot."""

    def scores(self, words: Words, descriptors: Descriptors) -> NDArray[np.float32]:
        """Score (size,) of every keyframe in the index for a query; higher is more alike."""


class VoteIndex:
    """Verified votes: descriptors of one word vote for each other when they are alike.

    Source: decisions 0004 (ORB) and 0022 (SIFT).
    """

    def __init__(self, index: covinz_core.InvertedIndex | covinz_core.ResidualIndex) -> None:
        self._index = index

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

    def __init__(self, vocabulary: CoreVocabulary) -> None:
        self._index = covinz_core.TfIdfIndex(vocabulary)

    def add(self, words: Words, descriptors: Descriptors) -> int:
        """Put a keyframe in and return its slot."""
        return int(self._index.add(words))

    def scores(self, words: Words, descriptors: Descriptors) -> NDArray[np.float32]:
        """L1 similarity (size,) of the tf-idf vectors."""
        scores: NDArray[np.float32] = self._index.scores(words)
        return scores


def load_vocabulary(config: PlaceRecognitionConfig, kind: FeatureKind) -> CoreVocabulary:
    """Read the vocabulary of a kind; a relative path counts from the checkout.

    Raises:
        ConfigError: If the file is missing or is no vocabulary of that kind.
    """
    path = config.vocabulary if kind == "orb" else config.sift.vocabulary
    of_kind = covinz_core.Vocabulary if kind == "orb" else covinz_core.ByteVocabulary
    try:
        return of_kind.from_bytes((CHECKOUT / path).read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot use the vocabulary {path}: {error}") from error


def min_score(config: PlaceRecognitionConfig, kind: FeatureKind) -> float:
    """Least score of a candidate by features of a kind."""
    own = config.sift.min_score if kind == "sift" else None
    return config.min_score if own is None else own


def new_index(
    config: PlaceRecognitionConfig, kind: FeatureKind, vocabulary: CoreVocabulary
) -> PlaceIndex:
    """An empty index of a kind that scores as configured.

    Raises:
        ConfigError: If no score could ever pass the threshold.
    """
    if config.score == "votes":
        if isinstance(vocabulary, covinz_core.ByteVocabulary):
            return VoteIndex(covinz_core.ResidualIndex(vocabulary, config.sift.max_hamming))
        return VoteIndex(covinz_core.InvertedIndex(config.max_hamming))
    least = min_score(config, kind)
    if least > 1:
        raise ConfigError(
            f"place_recognition.min_score is {least}, but tf_idf scores are at most 1"
        )
    return TfIdfIndex(vocabulary)
