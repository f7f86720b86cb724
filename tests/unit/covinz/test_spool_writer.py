"""What `send` does when the disk is slow, full, or slow and then full."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from covinz import codec
from covinz.config import AgentConfig
from covinz.spool import Spool, SpoolError
from covinz.spool_rows import SpoolEntry
from covinz.spool_writer import SpoolWriter, StampError
from covinz.types import KeyframeId
from tests.local_ingest import WAIT_S
from tests.uploads import CAMERA, OTHER_SESSION, SESSION, message

PATIENT = AgentConfig(max_send_wait_s=WAIT_S)
HASTY = AgentConfig(max_send_wait_s=0.0)


class SlowSpool(Spool):
    """A spool on a disk that goes on and fails when it is told to."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "a0", AgentConfig())
        self.goes_on = threading.Event()
        self.goes_on.set()
        self.failures = 0
        self.batches: list[int] = []
        self.began = threading.Semaphore(0)

    def append(self, entries: Sequence[SpoolEntry]) -> None:
        self.batches.append(len(entries))
        self.began.release()
        assert self.goes_on.wait(WAIT_S)
        if self.failures:
            self.failures -= 1
            raise SpoolError("disk full")
        super().append(entries)


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[SlowSpool]:
    spool = SlowSpool(tmp_path / "a0.spool")
    yield spool
    spool.close()


@pytest.fixture
def start(spool: SlowSpool) -> Iterator[Callable[[AgentConfig], SpoolWriter]]:
    started: list[SpoolWriter] = []

    def start(config: AgentConfig) -> SpoolWriter:
        writer = SpoolWriter(spool, SESSION, config, lambda: None, retry_s=0.01)
        writer.start()
        started.append(writer)
        return writer

    yield start
    spool.goes_on.set()
    spool.failures = 0
    for writer in started:
        writer.stop(WAIT_S)


Start = Callable[[AgentConfig], SpoolWriter]


def put(writer: SpoolWriter, number: int, stamp_ns: int | None = None) -> KeyframeId:
    def encode(session: str, seq: int) -> SpoolEntry:
        name = KeyframeId("a0", session, seq)
        stamp = number if stamp_ns is None else stamp_ns
        return SpoolEntry(name, stamp, message(number), CAMERA.hash, codec.encode(CAMERA))

    return writer.put(encode)


def spooled(spool: Spool) -> list[tuple[str, int]]:
    rows = []
    while (row := spool.take()) is not None:
        rows.append((row.session, row.first_seq))
    return rows


def test_a_fast_disk_has_it_when_put_returns(spool: SlowSpool, start: Start) -> None:
    writer = start(PATIENT)
    for number in range(5):
        assert put(writer, number) == KeyframeId("a0", SESSION, number)
        assert (len(spool), writer.unsaved) == (number + 1, 0)


def test_a_slow_disk_follows_in_one_commit(spool: SlowSpool, start: Start) -> None:
    writer = start(HASTY)
    spool.goes_on.clear()
    put(writer, 0)
    assert spool.began.acquire(timeout=WAIT_S)
    for number in range(1, 6):
        put(writer, number)
    assert (writer.unsaved, len(spool)) == (6, 0)
    assert not writer.wait_saved(0.0)
    spool.goes_on.set()
    assert writer.wait_saved(WAIT_S)
    assert spool.batches == [1, 5]
    assert spooled(spool) == [(SESSION, seq) for seq in range(6)]


def test_who_waits_is_told_that_the_disk_is_full(spool: SlowSpool, start: Start) -> None:
    writer = start(PATIENT)
    spool.failures = 2
    for _ in range(2):
        with pytest.raises(SpoolError, match="disk full"):
            put(writer, 0)
    assert writer.unsaved == 0
    assert put(writer, 0).seq == 0  # there is room again, and no number was used up
    assert spooled(spool) == [(SESSION, 0)]


def test_what_was_accepted_waits_for_room_and_nothing_more_is_accepted(
    spool: SlowSpool, start: Start
) -> None:
    writer = start(HASTY)
    spool.goes_on.clear()
    put(writer, 0)
    put(writer, 1)
    spool.failures = 1
    assert spool.began.acquire(timeout=WAIT_S)
    spool.goes_on.set()
    assert spool.began.acquire(timeout=WAIT_S)  # tried again by itself
    assert writer.wait_saved(WAIT_S)
    assert put(writer, 2).seq == 2
    assert writer.wait_saved(WAIT_S)
    assert spooled(spool) == [(SESSION, 0), (SESSION, 1), (SESSION, 2)]


def test_a_full_disk_behind_a_slow_one(spool: SlowSpool, start: Start) -> None:
    writer = start(HASTY)
    spool.goes_on.clear()
    spool.failures = 10**9
    put(writer, 0)
    assert spool.began.acquire(timeout=WAIT_S)
    spool.goes_on.set()
    # Accepted before the failure or refused after it: refused in any case in the end.
    refused = threading.Event()
    for number in range(1, 10**6):
        try:
            put(writer, number)
        except SpoolError as error:
            assert "disk full" in str(error)
            refused.set()
            break
    assert refused.is_set()
    kept = writer.unsaved
    with pytest.raises(SpoolError, match="disk full"):
        put(writer, 10**6)
    spool.failures = 0
    assert writer.wait_saved(WAIT_S)
    assert put(writer, 10**6).seq == kept
    assert writer.wait_saved(WAIT_S)
    assert spooled(spool) == [(SESSION, seq) for seq in range(kept + 1)]


def test_memory_is_bounded(spool: SlowSpool, start: Start) -> None:
    config = HASTY.model_copy(update={"max_unsaved_bytes": 3 * len(message())})
    writer = start(config)
    spool.goes_on.clear()
    for number in range(3):
        put(writer, 0, stamp_ns=number)
    with pytest.raises(SpoolError, match="too slow: 3 keyframes wait"):
        put(writer, 0, stamp_ns=3)
    spool.goes_on.set()
    assert writer.wait_saved(WAIT_S)
    assert put(writer, 0, stamp_ns=3).seq == 3


def test_time_does_not_go_back_within_a_session(spool: SlowSpool, start: Start) -> None:
    writer = start(PATIENT)
    put(writer, 0, stamp_ns=2_000_000_000)
    put(writer, 1, stamp_ns=2_000_000_000)  # two cameras
    with pytest.raises(StampError, match=r"1\.500 s before .* new_session"):
        put(writer, 2, stamp_ns=500_000_000)
    writer.new_session(OTHER_SESSION)
    put(writer, 2, stamp_ns=500_000_000)
    assert spooled(spool) == [(SESSION, 0), (SESSION, 1), (OTHER_SESSION, 0)]


def test_a_session_that_goes_on_knows_its_time(spool: SlowSpool, start: Start) -> None:
    put(start(PATIENT), 0, stamp_ns=10)
    again = start(PATIENT)
    with pytest.raises(StampError):
        put(again, 1, stamp_ns=9)
    assert put(again, 1, stamp_ns=11).seq == 1


def test_a_message_that_cannot_be_made_takes_no_number(spool: SlowSpool, start: Start) -> None:
    writer = start(PATIENT)

    def fail(session: str, seq: int) -> SpoolEntry:
        raise ValueError("of no use")

    with pytest.raises(ValueError, match="of no use"):
        writer.put(fail)
    assert put(writer, 0).seq == 0


def test_a_failure_across_a_reset(spool: SlowSpool, start: Start) -> None:
    writer = start(PATIENT)
    put(writer, 0)
    spool.goes_on.clear()
    spool.failures = 1
    errors: list[SpoolError] = []

    def send() -> None:
        try:
            put(writer, 1)
        except SpoolError as error:
            errors.append(error)

    sender = threading.Thread(target=send)
    sender.start()
    for _ in range(2):
        assert spool.began.acquire(timeout=WAIT_S)
    writer.new_session(OTHER_SESSION)
    spool.goes_on.set()
    sender.join()
    assert len(errors) == 1
    assert put(writer, 1) == KeyframeId("a0", OTHER_SESSION, 0)


def test_many_senders(spool: SlowSpool, start: Start) -> None:
    writer = start(PATIENT)
    sent: list[KeyframeId] = []

    def send() -> None:
        for _ in range(20):
            sent.append(put(writer, 0))

    threads = [threading.Thread(target=send) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(name.seq for name in sent) == list(range(80))
    assert [seq for _, seq in spooled(spool)] == list(range(80))


def test_the_end_waits_for_the_disk_but_not_for_ever(
    spool: SlowSpool, start: Start, caplog: pytest.LogCaptureFixture
) -> None:
    writer = start(HASTY)
    spool.goes_on.clear()
    put(writer, 0)
    writer.stop(0.01)
    assert "1 keyframes" in caplog.text and "too slow" in caplog.text
    with pytest.raises(SpoolError, match="closed"):
        put(writer, 1)
    spool.goes_on.set()
    assert writer.wait_saved(WAIT_S)
