"""All places seen so far, looked up by every kind of feature: one vocabulary and index a kind.

Scores of two kinds cannot be compared: how many votes a true place gets depends on the detector,
the vocabulary and the code. So each kind ranks for itself, and ranks are merged: the best of each
kind, then the second of each, and so on. With one kind that is its own ranking.

Source: decision 0022.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from covinz.config import FeatureKind, PlaceRecognitionConfig
from covinz.types import FeatureType, Keyframe
from services.place_recognition.index import (
    CoreVocabulary,
    Descriptors,
    PlaceIndex,
    Vocabulary,
    Words,
    min_score,
    new_index,
)

Scores = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """One kind of feature of a keyframe, as its index takes it."""

    words: Words
    descriptors: Descriptors


Descriptions = Mapping[FeatureKind, Description]


@dataclass(frozen=True, slots=True, eq=False)
class _Kind:
    """What there is for one kind; `slots` are the places of the keyframes in its index."""

    vocabulary: Vocabulary
    index: PlaceIndex
    min_score: float
    slots: list[int] = field(default_factory=list)


class Places:
    """Keyframes by what they show; a slot is the place of a keyframe among all that were added.

    Args:
        config: How scores are made and which of them count.
        kinds: Kinds in use; of equal ranks the first one's comes first.
        vocabularies: Of every kind in use.

    Raises:
        ConfigError: If the options of an index cannot be used.
    """

    def __init__(
        self,
        config: PlaceRecognitionConfig,
        kinds: Sequence[FeatureKind],
        vocabularies: Mapping[FeatureKind, CoreVocabulary],
    ) -> None:
        self._config = config
        self._kinds = {
            kind: _Kind(
                vocabularies[kind],
                new_index(config, kind, vocabularies[kind]),
                min_score(config, kind),
            )
            for kind in kinds
        }
        self._size = 0

    def __len__(self) -> int:
        return self._size

    @property
    def identity(self) -> str:
        """Says what the vocabularies are; part of every job's id."""
        return " ".join(f"{kind}:{one.vocabulary.hash}" for kind, one in self._kinds.items())

    @property
    def kinds(self) -> tuple[FeatureKind, ...]:
        """The kinds in use."""
        return tuple(self._kinds)

    def describe(self, kf: Keyframe) -> Descriptions:
        """What a keyframe shows, by every kind in use of which it has enough features."""
        found: dict[FeatureKind, Description] = {}
        for kind, one in self._kinds.items():
            features = kf.features_of(FeatureType[kind.upper()])
            if features is not None and len(features) >= self._config.min_features:
                words = one.vocabulary.words(features.descriptors)
                found[kind] = Description(words, features.descriptors)
        return found

    def best(self, query: Descriptions, mask: Mask) -> list[tuple[int, float]]:
        """Slots of the best eligible keyframes, best first, each with the score that chose it.

        Args:
            query: What is looked up.
            mask: (size,) which slots are eligible.
        """
        by_kind = [self._ranked(self._kinds[kind], one, mask) for kind, one in query.items()]
        chosen: dict[int, float] = {}
        for ranks in zip_longest(*by_kind):
            for found in ranks:
                if found is not None and len(chosen) < self._config.num_candidates:
                    chosen.setdefault(*found)
        return list(chosen.items())

    def add(self, descriptions: Descriptions) -> int:
        """Put a keyframe into the index of each of its kinds; returns its slot."""
        for kind, one in descriptions.items():
            self._kinds[kind].index.add(one.words, one.descriptors)
            self._kinds[kind].slots.append(self._size)
        self._size += 1
        return self._size - 1

    def _ranked(self, kind: _Kind, query: Description, mask: Mask) -> Iterator[tuple[int, float]]:
        scores = kind.index.scores(query.words, query.descriptors)
        slots = np.array(kind.slots, dtype=np.int64)
        for row in best(scores, mask[slots], self._config, kind.min_score):
            yield int(slots[row]), float(scores[row])


def best(scores: Scores, mask: Mask, config: PlaceRecognitionConfig, min_score: float) -> list[int]:
    """The rows of the best eligible keyframes, best first; of equal ones the older first.

    Args:
        scores: (size,) score of every keyframe in an index.
        mask: (size,) which of them are eligible.
        config: `num_candidates`, and `min_score_ratio` of the best eligible score.
        min_score: Least score of a candidate.
    """
    rows = np.flatnonzero(mask & (scores > 0) & (scores >= min_score))
    if not len(rows):
        return []
    rows = rows[scores[rows] >= config.min_score_ratio * scores[rows].max()]
    order = np.lexsort((rows, -scores[rows]))
    return [int(row) for row in rows[order[: config.num_candidates]]]
