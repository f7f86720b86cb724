"""Gaps for a person: which keyframes, and in which words."""

from __future__ import annotations

import pytest

from covinz import client, codec, keyexprs
from covinz.gaps import concerns, in_words
from covinz.memory_bus import Hub
from covinz.types import Gap, LogRange
from tests.uploads import OTHER_SESSION, SESSION, keyframe

GAP = Gap("a0", SESSION, 3, 5, "spool full")


@pytest.mark.parametrize(
    ("keyframe", "is_meant"),
    [
        ("a0", True),
        ("a1", False),
        ("a0/3", True),
        ("a0/5", True),
        ("a0/2", False),
        ("a0/6", False),
        (f"a0/{SESSION}/4", True),
        (f"a0/{OTHER_SESSION}/4", False),
        ("a0/four", False),
        ("a0/x/y/4", False),
    ],
)
def test_which_keyframes_are_meant(keyframe: str, is_meant: bool) -> None:
    assert concerns(GAP, keyframe) == is_meant


def test_in_words() -> None:
    said = f"a0: keyframes 3 to 5 of session {SESSION} never came: spool full"
    assert in_words(GAP) == said
    one = Gap("a0", SESSION, 3, 3, "rejected: too_large")
    assert in_words(one) == f"a0: keyframe 3 of session {SESSION} never came: rejected: too_large"


def test_all_gaps_of_a_log_page_by_page() -> None:
    hub = Hub()
    server, operator = hub.join(), hub.join()
    other = Gap("a1", SESSION, 0, 0, "too old")
    items = [keyframe(0), GAP, keyframe(1), other, keyframe(2)]

    def answer(payload: bytes) -> bytes:
        first = codec.decode(payload, LogRange).start
        entries = [(i, codec.encode(items[i])) for i in range(first, min(first + 2, 5))]
        return codec.encode_log_page(OTHER_SESSION, len(items), entries)

    server.answer(keyexprs.LOG_RANGE, lambda query: query.reply(answer(query.payload)))
    assert list(client.gaps(operator)) == [GAP, other]
    operator.close()
    server.close()
