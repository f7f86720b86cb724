"""The spool over a real file: nothing lost, oldest first, and honest when it overflows."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from covinz import codec
from covinz.spool import Spool, SpoolError, SpoolRow
from covinz.types import Gap, KeyframeId, Rejected
from tests.uploads import CAMERA, OTHER_SESSION, SESSION, message

MANY_BYTES = 1 << 30
CAMERA_MESSAGE = codec.encode(CAMERA)
SIZE = len(message())


def send(spool: Spool, seq: int, session: str = SESSION) -> None:
    spool.append(KeyframeId("a0", session, seq), message(seq), CAMERA.hash, CAMERA_MESSAGE)


def take_all(spool: Spool) -> list[SpoolRow]:
    rows: list[SpoolRow] = []
    while (row := spool.take()) is not None:
        rows.append(row)
    return rows


def names(rows: list[SpoolRow]) -> list[tuple[bool, int, int]]:
    return [(row.is_gap, row.first_seq, row.last_seq) for row in rows]


def crash(spool: Spool) -> None:
    """End as a killed process does: nothing is flushed, no transaction ended."""
    spool.close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a0.spool"


@pytest.fixture
def spool(path: Path) -> Iterator[Spool]:
    spool = Spool(path, "a0", MANY_BYTES)
    yield spool
    spool.close()


def test_rows_come_oldest_first_and_only_once(spool: Spool) -> None:
    for seq in range(3):
        send(spool, seq)
    rows = take_all(spool)
    assert names(rows) == [(False, 0, 0), (False, 1, 1), (False, 2, 2)]
    assert [row.payload for row in rows] == [message(seq) for seq in range(3)]
    assert {row.camera_hash for row in rows} == {CAMERA.hash}
    assert spool.camera(CAMERA.hash) == CAMERA_MESSAGE
    assert len(spool) == 3


def test_a_released_row_comes_again_and_a_delivered_one_does_not(spool: Spool) -> None:
    send(spool, 0)
    send(spool, 1)
    first, second = take_all(spool)
    spool.release(first.position)
    spool.delivered(second.position)
    assert take_all(spool) == [first]
    assert len(spool) == 1


def test_rows_put_off_come_when_there_is_nothing_else(spool: Spool) -> None:
    send(spool, 0)
    send(spool, 1)
    row = spool.take()
    assert row is not None
    spool.release(row.position)
    later = [row.position]
    taken = [spool.take(later), spool.take(later), spool.take(later)]
    assert [row.first_seq if row else None for row in taken] == [1, 0, None]


def test_everything_unacknowledged_is_there_after_a_crash(path: Path) -> None:
    spool = Spool(path, "a0", MANY_BYTES)
    for seq in range(4):
        send(spool, seq)
    first, *_ = take_all(spool)
    spool.delivered(first.position)
    crash(spool)
    spool = Spool(path, "a0", MANY_BYTES)
    assert len(spool) == 3
    send(spool, 0, OTHER_SESSION)
    rows = take_all(spool)
    assert [(row.session, row.first_seq) for row in rows] == [
        (SESSION, 1),
        (SESSION, 2),
        (SESSION, 3),
        (OTHER_SESSION, 0),
    ]
    spool.close()


def test_sequence_numbers_are_never_given_twice(path: Path) -> None:
    spool = Spool(path, "a0", MANY_BYTES)
    assert spool.next_seq(SESSION) == 0
    send(spool, 0)
    (row,) = take_all(spool)
    spool.delivered(row.position)
    crash(spool)
    spool = Spool(path, "a0", MANY_BYTES)
    assert spool.next_seq(SESSION) == 1
    assert spool.next_seq(OTHER_SESSION) == 0
    spool.close()


def test_a_full_spool_drops_the_oldest_and_says_so(path: Path) -> None:
    spool = Spool(path, "a0", 4 * SIZE)
    for seq in range(10):
        send(spool, seq)
    (gap, *kept) = take_all(spool)
    assert (gap.is_gap, gap.first_seq) == (True, 0)
    assert names(kept) == [(False, seq, seq) for seq in range(gap.last_seq + 1, 10)]
    assert 2 <= len(kept) <= 4
    assert codec.decode(gap.payload, Gap) == Gap("a0", SESSION, 0, gap.last_seq, "spool full")
    assert sum(len(row.payload) for row in [gap, *kept]) <= 4 * SIZE
    spool.close()


def test_a_gap_that_was_sent_does_not_grow(path: Path) -> None:
    spool = Spool(path, "a0", 3 * SIZE)
    for seq in range(6):
        send(spool, seq)
    gap = spool.take()
    assert gap is not None
    assert gap.is_gap
    for seq in range(6, 12):
        send(spool, seq)
    spool.release(gap.position)
    again, following, *kept = take_all(spool)
    assert again == gap
    assert (following.is_gap, following.first_seq) == (True, gap.last_seq + 1)
    assert names(kept) == [(False, seq, seq) for seq in range(following.last_seq + 1, 12)]
    spool.close()


def test_a_gap_of_an_earlier_run_does_not_grow(path: Path) -> None:
    spool = Spool(path, "a0", 3 * SIZE)
    for seq in range(6):
        send(spool, seq)
    crash(spool)
    spool = Spool(path, "a0", 3 * SIZE)
    before = spool.take()
    assert before is not None
    spool.release(before.position)
    send(spool, 6)
    send(spool, 7)
    rows = take_all(spool)
    assert rows[0] == before
    assert (rows[1].is_gap, rows[1].first_seq) == (True, before.last_seq + 1)
    spool.close()


def test_gaps_do_not_span_sessions(path: Path) -> None:
    spool = Spool(path, "a0", 2 * SIZE)
    for seq in range(4):
        send(spool, seq)
    for seq in range(6):
        send(spool, seq, OTHER_SESSION)
    gaps = [codec.decode(row.payload, Gap) for row in take_all(spool) if row.is_gap]
    assert [(gap.session, gap.first_seq) for gap in gaps] == [(SESSION, 0), (OTHER_SESSION, 0)]
    assert gaps[0].last_seq == 3
    spool.close()


def test_what_is_in_flight_is_not_dropped(path: Path) -> None:
    spool = Spool(path, "a0", 3 * SIZE)
    send(spool, 0)
    flying = spool.take()
    assert flying is not None
    for seq in range(1, 8):
        send(spool, seq)
    spool.release(flying.position)
    first, gap, *kept = take_all(spool)
    assert first == flying
    assert (gap.is_gap, gap.first_seq) == (True, 1)
    assert names(kept) == [(False, seq, seq) for seq in range(gap.last_seq + 1, 8)]
    spool.close()


def test_the_newest_is_kept_however_small_the_spool(path: Path) -> None:
    spool = Spool(path, "a0", 1)
    for seq in range(3):
        send(spool, seq)
    assert names(take_all(spool)) == [(True, 0, 1), (False, 2, 2)]
    spool.close()


def test_a_refused_keyframe_becomes_a_gap_and_is_kept_aside(spool: Spool) -> None:
    send(spool, 0)
    send(spool, 1)
    bad = spool.take()
    assert bad is not None
    spool.rejected(bad.position, Rejected("too_large", "of 1 byte"))
    gap, good = take_all(spool)
    assert codec.decode(gap.payload, Gap) == Gap("a0", SESSION, 0, 0, "rejected: too_large")
    assert names([good]) == [(False, 1, 1)]
    (refused,) = spool.rejections()
    assert (refused.first_seq, refused.code, refused.reason) == (0, "too_large", "of 1 byte")
    # Even the gap may be refused; that ends it.
    spool.rejected(gap.position, Rejected("long_reason", "too long"))
    assert [row.is_gap for row in spool.rejections()] == [False, True]
    assert len(spool) == 1


def test_after_a_conflict_there_is_no_gap(spool: Spool) -> None:
    send(spool, 0)
    row = spool.take()
    assert row is not None
    spool.rejected(row.position, Rejected("conflict", "other content"))
    assert len(spool) == 0
    assert spool.take() is None


def test_refused_keyframes_make_way_first(path: Path) -> None:
    spool = Spool(path, "a0", 3 * SIZE)
    for seq in range(2):
        send(spool, seq)
    row = spool.take()
    assert row is not None
    spool.rejected(row.position, Rejected("too_large", ""))
    send(spool, 2)
    assert spool.rejections() == []
    assert names(take_all(spool)) == [(True, 0, 0), (False, 1, 1), (False, 2, 2)]
    spool.close()


def test_one_process_one_agent(path: Path, spool: Spool) -> None:
    with pytest.raises(SpoolError, match="in use"):
        Spool(path, "a0", MANY_BYTES)
    spool.close()
    with pytest.raises(SpoolError, match="spool of agent a0"):
        Spool(path, "a1", MANY_BYTES)
    Spool(path, "a0", MANY_BYTES).close()


def test_a_full_disk_is_reported_and_nothing_changes(path: Path) -> None:
    spool = Spool(path, "a0", MANY_BYTES)
    send(spool, 0)
    db = spool._file.db
    (pages,) = db.execute("PRAGMA page_count").fetchone()
    db.execute(f"PRAGMA max_page_count = {pages}")
    big = codec.encode(CAMERA) * 1000
    with pytest.raises(SpoolError, match="full"):
        spool.append(KeyframeId("a0", SESSION, 1), big, CAMERA.hash, CAMERA_MESSAGE)
    assert (len(spool), spool.next_seq(SESSION)) == (1, 1)
    db.execute("PRAGMA max_page_count = 1000000")
    send(spool, 1)
    assert names(take_all(spool)) == [(False, 0, 0), (False, 1, 1)]
    spool.close()


def test_what_append_returned_for_is_on_the_disk(path: Path, spool: Spool) -> None:
    # Another connection, as after a crash of this process, sees it at once.
    for seq in range(3):
        send(spool, seq)
        other = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
        assert other.execute("SELECT COUNT(*) FROM outbox").fetchone() == (seq + 1,)
        other.close()


def test_many_threads(spool: Spool) -> None:
    done: list[int] = []
    waiting = threading.Semaphore(0)

    def deliver() -> None:
        for _ in range(25):
            waiting.acquire()
            row = spool.take()
            assert row is not None
            done.append(row.first_seq)
            spool.delivered(row.position)

    threads = [threading.Thread(target=deliver) for _ in range(4)]
    for thread in threads:
        thread.start()
    for seq in range(100):
        send(spool, seq)
        waiting.release()
    for thread in threads:
        thread.join()
    assert sorted(done) == list(range(100))
    assert len(spool) == 0
