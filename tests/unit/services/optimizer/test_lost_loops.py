from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from queue import SimpleQueue

import pytest

from covinz import codec, keyexprs
from covinz.bus import Query
from covinz.memory_bus import Hub
from covinz.types import LoopPage, LoopRange
from services.optimizer.lost_loops import LoopsFound, LostLoops
from tests.fleets import closure, keyframe

PATIENCE_S = 20.0
LOG, OTHER_LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAV", "01ARZ3NDEKTSV4RRFFQ69G5FAW"
LOOPS = sorted(
    (closure(keyframe("a", 0, n).id, keyframe("b", 1, n).id) for n in range(5)),
    key=lambda loop: loop.job_id,
)


class Journal:
    """Two loops in a page; first of another log, then not there, then as it should be."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def answer(self, query: Query) -> None:
        after = codec.decode(query.payload, LoopRange).after
        self.asked.append(after)
        if len(self.asked) == 1:
            query.reply(codec.encode(LoopPage(OTHER_LOG, tuple(LOOPS[:1]))))
        elif len(self.asked) == 2:
            query.drop()
        else:
            left = [loop for loop in LOOPS if loop.job_id > after]
            query.reply(codec.encode(LoopPage(LOG, tuple(left[:2]))))


@pytest.fixture
def hub() -> Iterator[Hub]:
    yield Hub()


def test_all_loops_come_page_by_page_however_long_it_takes(hub: Hub) -> None:
    found: SimpleQueue[LoopsFound] = SimpleQueue()
    journal = Journal()
    with closing(hub.join()) as server, closing(hub.join()) as bus:
        lost = LostLoops(bus, found.put)
        lost.look(LOG)
        server.answer(keyexprs.JOB_LOOPS, journal.answer)
        pages = [found.get(timeout=PATIENCE_S) for _ in range(4)]
        assert {page.log_id for page in pages} == {LOG}
        assert [len(page.loops) for page in pages] == [2, 2, 1, 0]
        ids = [loop.job_id for page in pages for loop in page.loops]
        assert ids == [loop.job_id for loop in LOOPS]
        lost.close()
