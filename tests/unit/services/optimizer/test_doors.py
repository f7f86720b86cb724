"""Who finds the optimizer overloaded is told so at once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from covinz import codec, keyexprs
from covinz.bus import MessageTooLarge
from covinz.config import OptimizerConfig
from covinz.memory_bus import Hub, InMemoryBus
from covinz.service import Inbox
from covinz.types import Correction, RetryAfter
from services.optimizer.doors import Asked, LoopBrought, answer_question, open_doors
from services.optimizer.maps import Maps
from tests.fleets import keyframe


@pytest.fixture
def buses() -> Iterator[tuple[InMemoryBus, InMemoryBus]]:
    hub = Hub()
    ours, theirs = hub.join(), hub.join()
    yield ours, theirs
    ours.close()
    theirs.close()


def test_with_a_full_inbox_loops_are_to_come_again_and_questions_end(
    buses: tuple[InMemoryBus, InMemoryBus],
) -> None:
    ours, theirs = buses
    inbox = Inbox(capacity=1)
    assert inbox.put("something")
    with open_doors(ours, inbox):
        (reply,) = theirs.ask(keyexprs.LOOP, b"a loop")
        assert isinstance(codec.decode_upload_reply(reply), RetryAfter)
        assert theirs.ask(keyexprs.MAP_LIST) == []
    assert inbox.drain(9) == ["something"]


def test_loops_and_questions_go_through_the_inbox(
    buses: tuple[InMemoryBus, InMemoryBus],
) -> None:
    ours, theirs = buses
    inbox = Inbox()
    keys = [
        keyexprs.LOOP,
        keyexprs.MAP_LIST,
        keyexprs.map_snapshot("m"),
        keyexprs.agent_correction("a"),
    ]
    with open_doors(ours, inbox):
        for key, kind in zip(keys, (LoopBrought, Asked, Asked, Asked), strict=True):
            assert theirs.ask(key, b"", timeout_s=0.01) == []  # nobody takes it out yet
            event = inbox.take(10.0)
            assert isinstance(event, LoopBrought | Asked)
            assert (type(event), event.query.key) == (kind, key)


class TooSmall:
    """A query on a bus that carries nothing."""

    key = keyexprs.agent_correction("a")
    payload = b""

    def reply(self, payload: bytes) -> None:
        raise MessageTooLarge(f"{len(payload)} bytes")

    def drop(self) -> None:
        raise AssertionError("the bus has ended it already")


def test_an_answer_that_is_too_large_harms_nobody(caplog: pytest.LogCaptureFixture) -> None:
    kf = keyframe("a", 0, 0).id
    corrections = {"a": Correction(kf, kf.session, 1, np.eye(4), False, 1)}
    answer_question(TooSmall(), Maps(OptimizerConfig()), corrections)
    assert "no answer to covinz/agent/a/down/correction" in caplog.text
