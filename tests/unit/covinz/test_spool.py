"""The spool over a real file: nothing lost, oldest first, and honest when it overflows."""

from __future__ import annotations

import contextlib
import json
import random
import shutil
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from covinz import codec
from covinz.config import AgentConfig
from covinz.machine import THIS_MACHINE, Machine, ThisMachine
from covinz.spool import Spool, SpoolError
from covinz.spool_rows import SpoolEntry, SpoolRow
from covinz.types import Gap, KeyframeId, Rejected
from tests.uploads import CAMERA, OTHER_SESSION, SESSION, message

MANY_BYTES = 1 << 30
CAMERA_MESSAGE = codec.encode(CAMERA)
SIZE = len(message())


class StandingClock(ThisMachine):
    """A machine whose clocks stand until somebody moves them."""

    def __init__(self) -> None:
        self.s = 1000.0
        self.ns = 1_800_000_000 * 10**9

    def monotonic_s(self) -> float:
        return self.s

    def now_ns(self) -> int:
        return self.ns


def opened(
    path: Path,
    max_bytes: int = MANY_BYTES,
    agent: str = "a0",
    machine: Machine = THIS_MACHINE,
    **more: object,
) -> Spool:
    values = {"max_spool_bytes": max_bytes, **more}
    return Spool(path, agent, AgentConfig.model_validate(values), machine)


def entry(seq: int, session: str = SESSION, payload: bytes | None = None) -> SpoolEntry:
    name = KeyframeId("a0", session, seq)
    return SpoolEntry(name, seq, payload or message(seq), CAMERA.hash, CAMERA_MESSAGE)


def send(spool: Spool, *seqs: int, session: str = SESSION) -> None:
    spool.append([entry(seq, session) for seq in seqs])


def take_all(spool: Spool) -> list[SpoolRow]:
    rows: list[SpoolRow] = []
    while (row := spool.take()) is not None:
        rows.append(row)
    return rows


def gaps(rows: list[SpoolRow]) -> list[Gap]:
    return [codec.decode(row.payload, Gap) for row in rows if row.is_gap]


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
    spool = opened(path)
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
    spool = opened(path)
    for seq in range(4):
        send(spool, seq)
    first, *_ = take_all(spool)
    spool.delivered(first.position)
    crash(spool)
    spool = opened(path)
    assert len(spool) == 3
    send(spool, 0, session=OTHER_SESSION)
    rows = take_all(spool)
    assert [(row.session, row.first_seq) for row in rows] == [
        (SESSION, 1),
        (SESSION, 2),
        (SESSION, 3),
        (OTHER_SESSION, 0),
    ]
    spool.close()


def test_sequence_numbers_are_never_given_twice(path: Path) -> None:
    spool = opened(path)
    assert spool.session(SESSION)[0] == 0
    send(spool, 0)
    (row,) = take_all(spool)
    spool.delivered(row.position)
    crash(spool)
    spool = opened(path)
    assert spool.session(SESSION)[0] == 1
    assert spool.session(OTHER_SESSION)[0] == 0
    spool.close()


def test_a_full_spool_drops_the_oldest_and_says_so(path: Path) -> None:
    spool = opened(path, 4 * SIZE)
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
    spool = opened(path, 3 * SIZE)
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
    spool = opened(path, 3 * SIZE)
    for seq in range(6):
        send(spool, seq)
    crash(spool)
    spool = opened(path, 3 * SIZE)
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
    spool = opened(path, 2 * SIZE)
    for seq in range(4):
        send(spool, seq)
    for seq in range(6):
        send(spool, seq, session=OTHER_SESSION)
    found = gaps(take_all(spool))
    assert [(gap.session, gap.first_seq) for gap in found] == [(SESSION, 0), (OTHER_SESSION, 0)]
    assert found[0].last_seq == 3
    spool.close()


def test_what_is_in_flight_is_not_dropped(path: Path) -> None:
    spool = opened(path, 3 * SIZE)
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
    spool = opened(path, 1)
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


def test_one_process_one_agent(path: Path, spool: Spool) -> None:
    with pytest.raises(SpoolError, match="in use"):
        opened(path)
    spool.close()
    with pytest.raises(SpoolError, match="spool of agent a0"):
        opened(path, MANY_BYTES, "a1")
    opened(path).close()


def test_a_full_disk_is_reported_and_nothing_changes(path: Path) -> None:
    spool = opened(path)
    send(spool, 0)
    db = spool._file.db
    (pages,) = db.execute("PRAGMA page_count").fetchone()
    db.execute(f"PRAGMA max_page_count = {pages}")
    big = codec.encode(CAMERA) * 1000
    with pytest.raises(SpoolError, match="full"):
        spool.append([entry(1, payload=big)])
    assert (len(spool), spool.session(SESSION)) == (1, (1, 0))
    db.execute("PRAGMA max_page_count = 1000000")
    send(spool, 1)
    assert names(take_all(spool)) == [(False, 0, 0), (False, 1, 1)]
    spool.close()


def test_a_spool_that_filled_its_disk_goes_on_once_it_is_delivered(path: Path) -> None:
    spool = opened(path)
    db = spool._file.db
    db.execute("PRAGMA max_page_count = 300")
    big = b"x" * 40_000
    seq = 0
    for _ in range(3):
        first = seq
        while True:
            try:
                spool.append([entry(seq, payload=big)])
            except SpoolError as error:
                assert "full" in str(error)
                break
            seq += 1
        assert seq - first > 15
        rows = take_all(spool)
        assert [row.first_seq for row in rows] == list(range(first, seq))
        for row in rows:
            spool.delivered(row.position)
        assert len(spool) == 0
    spool.close()


def test_acknowledged_keyframes_make_room_on_a_full_disk(path: Path) -> None:
    spool = opened(path)
    spool._file.db.execute("PRAGMA max_page_count = 300")
    big = b"x" * 40_000
    with pytest.raises(SpoolError, match="full"):
        for seq in range(100):
            spool.append([entry(seq, payload=big)])
    row = spool.take()
    assert row is not None
    with spool._lock:  # the delete did not fit then
        spool._settled.add(row.position)
    spool.append([entry(100, payload=big)])
    assert spool._file.db.execute("SELECT MIN(position) FROM outbox").fetchone() == (2,)
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


def test_a_gap_joins_its_neighbours_on_both_sides(path: Path) -> None:
    spool = opened(path, 3 * SIZE)
    send(spool, 0, 1)
    in_flight = [spool.take(), spool.take()]
    for seq in range(2, 8):
        send(spool, seq)
    assert all(in_flight)
    for row in in_flight:
        assert row is not None
        spool.release(row.position)
    # Both were older than the gap that grew behind them; now they go too, the later one last.
    for seq in range(8, 12):
        send(spool, seq)
    (gap,) = gaps(take_all(spool))
    assert (gap.first_seq, gap.reason) == (0, "spool full")
    assert spool.report().dropped == gap.last_seq + 1
    spool.close()


def test_what_was_dropped_is_known_and_told_after_a_crash(path: Path) -> None:
    spool = opened(path, 3 * SIZE)
    for seq in range(9):
        send(spool, seq)
    before = spool.report()
    crash(spool)
    spool = opened(path)
    assert spool.report() == before
    (gap,) = gaps(take_all(spool))
    assert before.dropped == gap.last_seq + 1 - gap.first_seq >= 5
    spool.close()


def test_what_is_too_old_is_given_up(path: Path) -> None:
    machine = StandingClock()
    spool = opened(path, machine=machine, max_spool_age_s=60.0)
    send(spool, 0, 1)
    machine.s += 40.0
    send(spool, 2)
    machine.s += 19.0
    assert names(take_all(spool)) == [(False, 0, 0), (False, 1, 1), (False, 2, 2)]
    for position in (1, 2, 3):
        spool.release(position)
    machine.s += 2.0
    first, second = take_all(spool)
    assert gaps([first]) == [Gap("a0", SESSION, 0, 1, "too old")]
    assert names([second]) == [(False, 2, 2)]
    assert spool.report().dropped == 2
    spool.close()


def test_only_the_time_that_the_program_runs_makes_a_keyframe_old(path: Path) -> None:
    machine = StandingClock()
    spool = opened(path, machine=machine, max_spool_age_s=60.0)
    machine.s += 30.0
    send(spool, 0)
    machine.s += 50.0
    send(spool, 1)
    crash(spool)
    # Started again after years, by either clock.
    machine.s, machine.ns = 5.0, machine.ns + 10**18
    spool = opened(path, machine=machine, max_spool_age_s=60.0)
    assert len(take_all(spool)) == 2
    for position in (1, 2):
        spool.release(position)
    machine.s += 11.0
    assert names(take_all(spool)) == [(True, 0, 0), (False, 1, 1)]
    spool.close()


def test_a_damaged_keyframe_is_never_sent(path: Path) -> None:
    spool = opened(path)
    send(spool, 0, 1, 2)
    spool._file.db.execute(
        "UPDATE outbox SET payload = CAST('!' || substr(payload, 2) AS BLOB) WHERE position = 2"
    )
    rows = take_all(spool)
    assert names(rows) == [(False, 0, 0), (True, 1, 1), (False, 2, 2)]
    assert gaps(rows) == [Gap("a0", SESSION, 1, 1, "damaged on the robot's disk")]
    assert spool.report().dropped == 1
    spool.close()


def test_a_damaged_gap_is_written_anew(path: Path) -> None:
    spool = opened(path, 1)
    send(spool, 0)
    send(spool, 1)
    spool._file.db.execute("UPDATE outbox SET payload = x'00' WHERE is_gap")
    assert gaps(take_all(spool)) == [Gap("a0", SESSION, 0, 0, "spool full")]
    spool.close()


def test_a_row_that_is_nonsense_is_an_error(path: Path) -> None:
    spool = opened(path)
    send(spool, 0)
    spool._file.db.execute("UPDATE outbox SET first_seq = 'x'")
    with pytest.raises(SpoolError, match="row 1 is damaged"):
        spool.take()
    spool.close()


def test_acknowledged_is_acknowledged_though_the_disk_be_full(path: Path) -> None:
    spool = opened(path)
    send(spool, 0, 1)
    (first, second) = take_all(spool)
    spool._file.db.execute("PRAGMA query_only = 1")  # as a full disk: nothing can be written
    spool.delivered(first.position)
    assert len(spool) == 1
    spool.release(second.position)
    assert spool.take() == second
    with pytest.raises(SpoolError):
        send(spool, 2)
    assert len(spool) == 1
    spool._file.db.execute("PRAGMA query_only = 0")
    send(spool, 2)
    assert spool._file.db.execute("SELECT COUNT(*) FROM outbox").fetchone() == (2,)
    spool.close()


def test_refused_keyframes_are_files_with_a_reason(path: Path) -> None:
    machine = StandingClock()
    spool = opened(path, machine=machine)
    send(spool, 0)
    row = spool.take()
    assert row is not None
    spool.rejected(row.position, Rejected("too_large", "of 1 byte"))
    folder = path.with_name("a0.spool.rejected")
    assert (folder / f"{SESSION}-0.keyframe").read_bytes() == message(0)
    why = json.loads((folder / f"{SESSION}-0.keyframe.json").read_text())
    assert (why["code"], why["reason"]) == ("too_large", "of 1 byte")
    assert why["refused_at"] == "2027-01-15T08:00:00.000000+00:00"
    assert spool.report().rejected == 1
    spool.close()


def test_refused_keyframes_can_be_sent_again(path: Path) -> None:
    spool = opened(path)
    send(spool, 0, 1)
    for row in take_all(spool):
        spool.rejected(row.position, Rejected("too_large", ""))
    for row in take_all(spool):  # the gaps
        spool.delivered(row.position)
    assert (spool.send_again(), spool.rejections(), len(spool)) == (2, [], 2)
    crash(spool)
    spool = opened(path)
    rows = take_all(spool)
    assert [row.payload for row in rows] == [message(0), message(1)]
    assert spool.camera(rows[0].camera_hash) == CAMERA_MESSAGE
    assert spool.session(SESSION)[0] == 2
    spool.close()


def test_a_refusal_that_cannot_be_kept_leaves_the_keyframe_in_the_spool(path: Path) -> None:
    spool = opened(path)
    send(spool, 0)
    row = spool.take()
    assert row is not None
    folder = path.with_name("a0.spool.rejected")
    folder.write_bytes(b"")  # in its way
    with pytest.raises(SpoolError, match="rejected"):
        spool.rejected(row.position, Rejected("too_large", ""))
    spool.release(row.position)
    assert take_all(spool) == [row]
    folder.unlink()
    spool.rejected(row.position, Rejected("too_large", ""))
    assert len(spool.rejections()) == 1
    spool.close()


def test_a_spool_of_a_newer_version(path: Path) -> None:
    opened(path).close()
    with contextlib.closing(sqlite3.connect(path)) as db:
        db.execute("PRAGMA user_version = 3")
    with pytest.raises(SpoolError, match="format 3, this program reads format 2"):
        opened(path)


# As of 22 November 2026.
FORMAT_1 = """
    CREATE TABLE owner (agent TEXT NOT NULL);
    CREATE TABLE session (session TEXT PRIMARY KEY, next_seq INTEGER NOT NULL);
    CREATE TABLE camera (hash TEXT PRIMARY KEY, payload BLOB NOT NULL);
    CREATE TABLE outbox (position INTEGER PRIMARY KEY AUTOINCREMENT, session TEXT NOT NULL,
        is_gap INTEGER NOT NULL, first_seq INTEGER NOT NULL, last_seq INTEGER NOT NULL,
        camera_hash TEXT NOT NULL, reason TEXT NOT NULL DEFAULT '', payload BLOB NOT NULL);
    CREATE TABLE rejected (number INTEGER PRIMARY KEY AUTOINCREMENT, session TEXT NOT NULL,
        is_gap INTEGER NOT NULL, first_seq INTEGER NOT NULL, last_seq INTEGER NOT NULL,
        code TEXT NOT NULL, reason TEXT NOT NULL, payload BLOB NOT NULL);
    PRAGMA user_version = 1;
"""


def test_a_spool_of_an_older_version_goes_on(path: Path) -> None:
    name = int.from_bytes(b"cvzS", "big")
    with contextlib.closing(sqlite3.connect(path)) as db:
        db.executescript(f"PRAGMA journal_mode = WAL; PRAGMA application_id = {name}; {FORMAT_1}")
        db.execute("INSERT INTO owner VALUES ('a0')")
        db.execute("INSERT INTO session VALUES (?, 3)", (SESSION,))
        db.execute("INSERT INTO camera VALUES (?, ?)", (CAMERA.hash, CAMERA_MESSAGE))
        for seq in (1, 2):
            row = (SESSION, seq, seq, CAMERA.hash, message(seq))
            db.execute("INSERT INTO outbox VALUES (NULL, ?, 0, ?, ?, ?, '', ?)", row)
        db.execute("INSERT INTO rejected VALUES (NULL, ?, 0, 0, 0, 'x', '', x'00')", (SESSION,))
        db.commit()
    spool = opened(path)
    assert spool.report().rejected == 1
    assert spool.session(SESSION) == (3, 0)
    send(spool, 3)
    rows = take_all(spool)
    assert [row.payload for row in rows] == [message(seq) for seq in (1, 2, 3)]
    assert spool.camera(rows[0].camera_hash) == CAMERA_MESSAGE
    spool.close()
    opened(path).close()


@pytest.mark.parametrize("file", ["a0.spool", "a0.spool-wal"])
@pytest.mark.parametrize("seed", range(12))
def test_a_torn_file_is_an_error_or_gives_what_was_written(
    path: Path, file: str, seed: int
) -> None:
    draw = random.Random(f"{file} {seed}")
    spool = opened(path)
    for seq in range(30):
        send(spool, seq)
    image = path.with_name("image")
    image.mkdir()
    for name in ("a0.spool", "a0.spool-wal"):
        shutil.copy(path.with_name(name), image / name)
    spool.close()
    torn = image / file
    content = bytearray(torn.read_bytes())
    if draw.random() < 0.5:
        del content[draw.randrange(len(content)) :]
    else:
        at = draw.randrange(len(content))
        content[at : at + 512] = draw.randbytes(len(content[at : at + 512]))
    torn.write_bytes(content)
    try:
        spool = opened(image / "a0.spool")
    except SpoolError:
        return
    with contextlib.suppress(SpoolError):
        for row in take_all(spool):
            assert row.is_gap or row.payload == message(row.first_seq)
    with contextlib.suppress(SpoolError):
        send(spool, 30)
    spool.close()


def test_closing_does_not_wait_for_a_disk_that_hangs(path: Path, spool: Spool) -> None:
    spool._lock.acquire()
    assert not spool.close(timeout_s=0.01)
    spool._lock.release()
    assert spool.close()
