"""Vocabulary and indices through the bindings: shapes, errors, worked examples."""

from __future__ import annotations

import hashlib

import covinz_core as core
import numpy as np
import pytest
from numpy.typing import NDArray

Descriptors = NDArray[np.uint8]


def clusters(num_clusters: int, per_cluster: int, seed: int = 0) -> Descriptors:
    """Random centres, about 128 bits apart, whose members differ in up to 3 bits."""
    rng = np.random.Generator(np.random.PCG64(seed))
    bits = np.repeat(rng.integers(0, 2, (num_clusters, 256)), per_cluster, axis=0)
    for row in bits:
        row[rng.integers(0, 256, 3)] ^= 1
    return np.packbits(bits.astype(np.uint8), axis=1)


def flipped(num_bits: int) -> Descriptors:
    """One descriptor (1, 32), `num_bits` away from zero."""
    return np.packbits(np.arange(256) < num_bits)[None]


@pytest.fixture(scope="module")
def vocabulary() -> core.Vocabulary:
    descriptors = clusters(30, 10)
    offsets = np.arange(0, 301, 30, dtype=np.int64)
    return core.Vocabulary.train(descriptors, offsets, branching=3, depth=3, seed=1)


def test_words_of_a_trained_vocabulary(vocabulary: core.Vocabulary) -> None:
    words = vocabulary.words(clusters(30, 10))
    assert words.dtype == np.uint32
    assert words.shape == (300,)
    assert set(words.tolist()) == set(range(vocabulary.num_words))
    assert vocabulary.idf.shape == (vocabulary.num_words,)
    assert vocabulary.words(np.empty((0, 32), np.uint8)).shape == (0,)


def test_idf_counts_images() -> None:
    a, b = clusters(2, 1)
    descriptors = np.stack([a, b, b, a, a])
    vocabulary = core.Vocabulary.train(descriptors, np.array([0, 3, 4, 5]), branching=2, depth=1)
    words = vocabulary.words(np.stack([a, b]))
    np.testing.assert_allclose(vocabulary.idf[words], [0.0, np.log(3.0)], rtol=1e-6)


def test_same_seed_same_bytes(vocabulary: core.Vocabulary) -> None:
    offsets = np.arange(0, 301, 30, dtype=np.int64)
    again = core.Vocabulary.train(clusters(30, 10), offsets, branching=3, depth=3, seed=1)
    assert again.to_bytes() == vocabulary.to_bytes()


def test_bytes_round_trip(vocabulary: core.Vocabulary) -> None:
    copy = core.Vocabulary.from_bytes(vocabulary.to_bytes())
    assert copy.hash == vocabulary.hash
    assert len(copy.hash) == 64
    np.testing.assert_array_equal(copy.words(clusters(30, 10)), vocabulary.words(clusters(30, 10)))


@pytest.mark.parametrize("data", [b"", b"covinz-v", bytes(1000), b"\xff" * 1000])
def test_foreign_bytes_are_a_value_error(data: bytes) -> None:
    with pytest.raises(ValueError, match="Vocabulary bytes"):
        core.Vocabulary.from_bytes(data)


def test_every_altered_byte_is_a_value_error(vocabulary: core.Vocabulary) -> None:
    data = bytearray(vocabulary.to_bytes())
    for i in range(len(data)):
        data[i] ^= 0x10
        with pytest.raises(ValueError, match="checksum"):
            core.Vocabulary.from_bytes(bytes(data))
        data[i] ^= 0x10


@pytest.mark.parametrize("length", [0, 31, 32, 51, 100])
def test_every_truncation_is_a_value_error(vocabulary: core.Vocabulary, length: int) -> None:
    content = vocabulary.to_bytes()[:length]
    with pytest.raises(ValueError, match="Vocabulary bytes"):
        core.Vocabulary.from_bytes(content)
    with pytest.raises(ValueError, match="Vocabulary bytes"):
        core.Vocabulary.from_bytes(content + hashlib.sha256(content).digest())


def test_hash_is_the_known_one(vocabulary: core.Vocabulary) -> None:
    """Guards against a change of draws, order or format: loop job ids depend on the hash."""
    assert vocabulary.hash == "004b2e94fe6cecfa7e3be70b44d303833b5b6f58c40d59f9bc4dee197228c8fa"
    assert vocabulary.to_bytes()[-32:].hex() == vocabulary.hash


@pytest.mark.parametrize("length", [0, 31, 33, 128])
def test_other_descriptor_lengths_are_a_value_error(
    vocabulary: core.Vocabulary, length: int
) -> None:
    descriptors = np.zeros((4, length), np.uint8)
    words = np.zeros(4, np.uint32)
    with pytest.raises(ValueError, match="32 bytes"):
        vocabulary.words(descriptors)
    with pytest.raises(ValueError, match="32 bytes"):
        core.Vocabulary.train(descriptors, np.array([0, 4]))
    index = core.InvertedIndex()
    with pytest.raises(ValueError, match="32 bytes"):
        index.add(words, descriptors)
    with pytest.raises(ValueError, match="32 bytes"):
        index.votes(words, descriptors)
    assert index.size == 0


def test_training_without_images_is_a_value_error() -> None:
    with pytest.raises(ValueError, match="no descriptors"):
        core.Vocabulary.train(np.empty((0, 32), np.uint8), np.array([0]))
    with pytest.raises(ValueError, match="image offsets"):
        core.Vocabulary.train(clusters(2, 2), np.array([0, 3]))


def test_votes_of_a_worked_example() -> None:
    index = core.InvertedIndex(max_hamming=40)
    assert index.add(np.array([5], np.uint32), flipped(40)) == 0
    assert index.add(np.array([5], np.uint32), flipped(41)) == 1
    assert index.add(np.array([6], np.uint32), flipped(0)) == 2
    votes = index.votes(np.array([5, 5], np.uint32), np.concatenate([flipped(0), flipped(1)]))
    # Both features reach keyframe 0; the second also keyframe 1, at exactly 40 bits.
    expected = [np.log(3.0) + np.log(1.5), np.log(1.5), 0.0]
    assert votes.dtype == np.float32
    np.testing.assert_allclose(votes, expected, rtol=1e-6)
    assert len(index) == index.size == 3


def test_votes_need_a_word_per_descriptor() -> None:
    index = core.InvertedIndex()
    with pytest.raises(ValueError, match="differ"):
        index.add(np.zeros(2, np.uint32), flipped(0))
    with pytest.raises(ValueError, match="max_hamming"):
        core.InvertedIndex(max_hamming=257)


def test_tf_idf_scores_equal_and_disjoint_bags(vocabulary: core.Vocabulary) -> None:
    index = core.TfIdfIndex(vocabulary)
    weighty = np.flatnonzero(vocabulary.idf > 0).astype(np.uint32)
    assert index.add(weighty[:5]) == 0
    assert index.add(weighty[5:10]) == 1
    np.testing.assert_allclose(index.scores(weighty[:5]), [1.0, 0.0], atol=1e-6)
    with pytest.raises(ValueError, match="not in the vocabulary"):
        index.add(np.array([vocabulary.num_words], np.uint32))
    assert index.size == 2


def numbers(num_clusters: int, per_cluster: int, seed: int = 0) -> Descriptors:
    """Random centres of bytes, whose members differ by up to 4 in every component."""
    rng = np.random.Generator(np.random.PCG64(seed))
    centres = rng.integers(4, 252, (num_clusters, 128))
    noise = rng.integers(-4, 5, (num_clusters, per_cluster, 128))
    return (centres[:, None] + noise).reshape(-1, 128).astype(np.uint8)


@pytest.fixture(scope="module")
def byte_vocabulary() -> core.ByteVocabulary:
    offsets = np.arange(0, 301, 30, dtype=np.int64)
    return core.ByteVocabulary.train(numbers(30, 10), offsets, branching=3, depth=3, seed=1)


def test_words_of_bytes(byte_vocabulary: core.ByteVocabulary) -> None:
    words = byte_vocabulary.words(numbers(30, 10))
    assert set(words.tolist()) == set(range(byte_vocabulary.num_words))
    copy = core.ByteVocabulary.from_bytes(byte_vocabulary.to_bytes())
    assert copy.hash == byte_vocabulary.hash
    np.testing.assert_array_equal(copy.words(numbers(30, 10)), words)
    assert copy.to_bytes()[-32:].hex() == copy.hash


def test_byte_vocabulary_has_the_known_hash(byte_vocabulary: core.ByteVocabulary) -> None:
    """Guards against a change of draws, order or format: loop job ids depend on the hash."""
    assert (
        byte_vocabulary.hash == "846ee53008cff51fcc96d6496945043def2ec6c0f10f836f09c60364f6c6d4a4"
    )


def test_kinds_of_vocabularies_are_not_mixed_up(
    vocabulary: core.Vocabulary, byte_vocabulary: core.ByteVocabulary
) -> None:
    with pytest.raises(ValueError, match="128-byte descriptors"):
        core.Vocabulary.from_bytes(byte_vocabulary.to_bytes())
    with pytest.raises(ValueError, match="32-byte descriptors"):
        core.ByteVocabulary.from_bytes(vocabulary.to_bytes())
    with pytest.raises(ValueError, match="128 bytes"):
        byte_vocabulary.words(np.zeros((4, 32), np.uint8))
    with pytest.raises(ValueError, match="128 bytes"):
        core.ResidualIndex(byte_vocabulary).add(np.zeros(4, np.uint32), clusters(4, 1))


def test_residual_votes_find_noisy_copies() -> None:
    # Few words, each of many clusters: a code tells the clusters of one word apart.
    byte_vocabulary = core.ByteVocabulary.train(
        numbers(30, 10), np.array([0, 300]), branching=3, depth=1
    )
    members = numbers(30, 10).reshape(30, 10, 128)
    index = core.ResidualIndex(byte_vocabulary)
    for cluster in members:
        index.add(byte_vocabulary.words(cluster[:5]), cluster[:5])
    assert len(index) == index.size == 30
    for slot, cluster in enumerate(members):
        votes = index.votes(byte_vocabulary.words(cluster[5:]), cluster[5:])
        assert votes.dtype == np.float32
        assert votes.argmax() == slot
    with pytest.raises(ValueError, match="max_hamming"):
        core.ResidualIndex(byte_vocabulary, max_hamming=129)
    with pytest.raises(ValueError, match="not in the vocabulary"):
        index.votes(np.array([10**6], np.uint32), members[0, :1])


def test_tf_idf_takes_either_kind(byte_vocabulary: core.ByteVocabulary) -> None:
    index = core.TfIdfIndex(byte_vocabulary)
    weighty = np.flatnonzero(byte_vocabulary.idf > 0).astype(np.uint32)
    index.add(weighty[:5])
    np.testing.assert_allclose(index.scores(weighty[:5]), [1.0], atol=1e-6)
