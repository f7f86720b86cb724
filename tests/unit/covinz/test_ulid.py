"""ULIDs against the specification's example and its ordering."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz.types import ULID_PATTERN
from covinz.ulid import new_ulid, ulid

TIMES = st.integers(0, 2**48 - 1)
ENTROPY = st.binary(min_size=10, max_size=10)


def test_known_values() -> None:
    # The time of the specification's example, 01ARZ3NDEK..., is 1469922850259 ms.
    assert ulid(1469922850259, bytes(10)) == "01ARZ3NDEK" + "0" * 16
    assert ulid(2**48 - 1, b"\xff" * 10) == "7" + "Z" * 25
    assert ulid(0, bytes(9) + b"\x21") == "0" * 24 + "11"


@given(TIMES, ENTROPY, TIMES, ENTROPY)
def test_text_sorts_like_time_and_entropy(t: int, e: bytes, u: int, f: bytes) -> None:
    assert (ulid(t, e) < ulid(u, f)) == ((t, e) < (u, f))
    assert ULID_PATTERN.fullmatch(ulid(t, e))


def test_what_does_not_fit_is_refused() -> None:
    for time_ms, entropy in ((-1, bytes(10)), (2**48, bytes(10)), (0, bytes(9))):
        with pytest.raises(ValueError, match="ULID"):
            ulid(time_ms, entropy)


def test_new_ones_differ() -> None:
    assert len({new_ulid() for _ in range(100)}) == 100
