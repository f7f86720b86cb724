"""Matching of packed descriptors through the bindings: OpenCV's matches, shapes, errors."""

from __future__ import annotations

import covinz_core as core
import numpy as np
import pytest
from numpy.typing import NDArray

Descriptors = NDArray[np.uint8]
_SUPPORTED = [s for s in core.InstructionSet if core.is_supported(s)]


def images(num_bytes: int) -> tuple[Descriptors, Descriptors]:
    """Two images; every other candidate is a query descriptor with one byte changed."""
    rng = np.random.default_rng(1)
    query = rng.integers(0, 256, (60, num_bytes), dtype=np.uint8)
    cand = rng.integers(0, 256, (71, num_bytes), dtype=np.uint8)
    cand[::2] = query[:36]
    cand[::2, 5] ^= 3
    return query, cand


@pytest.mark.parametrize("instruction_set", _SUPPORTED)
@pytest.mark.parametrize("norm", list(core.DescriptorNorm))
def test_the_matches_are_those_of_opencv(
    instruction_set: core.InstructionSet, norm: core.DescriptorNorm
) -> None:
    options = core.MatchingOptions()
    options.norm = norm
    query, cand = images(128)
    expected = core.match_descriptors(query, cand, options)
    packed = core.PackedDescriptors(query), core.PackedDescriptors(cand)
    assert np.array_equal(core.match_packed(*packed, options, instruction_set), expected)
    assert expected.tolist() == [[i, 2 * i] for i in range(36)]


def test_rows_without_a_bearing_take_no_part() -> None:
    query, cand = images(32)
    bearings = np.ones((60, 3))
    bearings[:10, 1] = np.nan
    packed = core.PackedDescriptors(query, bearings)
    assert len(packed) == 50
    matches = core.match_packed(packed, core.PackedDescriptors(cand), core.MatchingOptions())
    assert matches.tolist() == [[i, 2 * i] for i in range(10, 36)]


def test_no_descriptors_no_matches() -> None:
    none = core.PackedDescriptors(np.empty((0, 32), np.uint8))
    matches = core.match_packed(none, none, core.MatchingOptions())
    assert matches.shape == (0, 2)


def test_misuse_is_an_error() -> None:
    query, cand = images(32)
    with pytest.raises(ValueError, match="59 bearings but 60 descriptors"):
        core.PackedDescriptors(query, np.ones((59, 3)))
    with pytest.raises(ValueError, match="32 and 31 bytes"):
        core.match_packed(
            core.PackedDescriptors(query),
            core.PackedDescriptors(cand[:, :31].copy()),
            core.MatchingOptions(),
        )


def test_the_best_instruction_set_is_supported() -> None:
    assert core.best_instruction_set() in _SUPPORTED
    assert core.InstructionSet.PORTABLE in _SUPPORTED
