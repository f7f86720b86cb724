"""The codec's own writer gives the bytes of the FlatBuffers runtime."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from covinz import codec
from covinz.codec.reader import message_name, read
from covinz.codec.writer import write
from tests.contract.examples import EXAMPLES
from tests.unit.covinz import flatbuffers_writer
from tests.unit.covinz.messages import messages


def is_written_alike(payload: bytes) -> bool:
    name = message_name(payload)
    fields = read(payload, name)
    return write(name, fields) == flatbuffers_writer.write(name, fields) == payload


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_are_those_of_the_runtime(name: str) -> None:
    assert is_written_alike(codec.encode(EXAMPLES[name]))


@settings(max_examples=200)
@given(messages)
def test_messages_are_those_of_the_runtime(message: Any) -> None:
    assert is_written_alike(codec.encode(message))


def test_absent_fields_and_any_alignment() -> None:
    for length in range(9):
        for detail in (None, "x" * length):
            fields = read(codec.encode(EXAMPLES["Rejection"]), "Rejection")
            fields |= {"detail": detail, "count": 0.0, "stage": "s" * (length + 1)}
            assert write("Rejection", fields) == flatbuffers_writer.write("Rejection", fields)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"num_inliers": 2**32}, "LoopClosure"),
        ({"num_inliers": 0.5}, "LoopClosure"),
        ({"pose_cand_query": (0.0,) * 6}, "LoopClosure"),
        ({"covariance": np.ones(36, dtype=complex)}, "LoopClosure"),
        ({"covariance": None}, "LoopClosure.covariance is missing"),
    ],
)
def test_what_does_not_fit_is_not_written(change: dict[str, Any], reason: str) -> None:
    fields = read(codec.encode(EXAMPLES["LoopClosure"]), "LoopClosure") | change
    with pytest.raises(ValueError, match=reason):
        write("LoopClosure", fields)
