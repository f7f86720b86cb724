from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from covinz import codec, keyexprs
from covinz.bus import Query
from covinz.config import PlaceRecognitionConfig, WorkerConfig
from covinz.durable import open_reader
from covinz.memory_bus import Hub, InMemoryBus
from covinz.service import Inbox
from covinz.types import (
    Duplicate,
    JobDone,
    JobPage,
    JobRange,
    JobState,
    KeyframeId,
    Lease,
    LeaseRequest,
    LoopJob,
    Rejected,
    Rejection,
    RigMember,
    Stored,
)
from services.place_recognition.desk import RETRY_S, Desk, WorkerBack, WorkerGone, open_desk
from services.place_recognition.dispatcher import Dispatcher
from services.place_recognition.journal import Journal

LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
OTHER_LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAW"
PATIENCE_S = 20.0


def job(n: int) -> LoopJob:
    def member(agent: str, seq: int) -> RigMember:
        return RigMember(KeyframeId(agent, LOG, seq), np.eye(4), "0123456789abcdef")

    query = (member("a", n), member("a", n + 1))
    return LoopJob(f"{n:032x}", query, tuple(member("b", n + i) for i in range(3)), 1.0)


def rejection(n: int) -> Rejection:
    one = job(n)
    return Rejection(one.id, one.query, one.cand, "matches", 3.0, 30.0, "", 1.0)


class Office:
    """A desk on a bus, moved on by the test: `step` is what the service's loop does."""

    def __init__(self, hub: Hub, path: Path, stack: ExitStack) -> None:
        self.path = path
        self.inbox = Inbox(capacity=4)
        self.bus = stack.enter_context(closing(hub.join()))
        self.journal = stack.enter_context(closing(Journal(path)))
        config = PlaceRecognitionConfig(long_poll_s=5.0, max_attempts=1)
        self.dispatcher: Dispatcher[Query] = Dispatcher(config, WorkerConfig(), self.journal)
        self.dispatcher.reset(LOG)
        self.desk = Desk(self.dispatcher, self.journal, self.bus)
        self.now_s = 0.0
        stack.enter_context(open_desk(self.bus, self.inbox))

    def set_writable(self, writable: bool) -> None:
        """Whether the journal's disk takes writes."""
        self.journal._file.db.execute(f"PRAGMA query_only = {not writable}")

    def step(self, seconds: float = 0.0) -> None:
        """Handle the next event, or only let time pass."""
        self.now_s += seconds
        if not seconds:
            event: Any = self.inbox.take(PATIENCE_S)
            assert event is not None
            self.desk.handle(event, self.now_s)
        self.desk.settle(self.now_s)


class Asked(threading.Thread):
    """A question under way in a thread of its own."""

    def __init__(self, bus: InMemoryBus, key: str, payload: bytes) -> None:
        super().__init__(daemon=True)
        self._bus, self._key, self._payload = bus, key, payload
        self._replies: list[bytes] = []
        self.start()

    def run(self) -> None:
        self._replies = self._bus.ask(self._key, self._payload, PATIENCE_S)

    def replies(self) -> list[bytes]:
        self.join(PATIENCE_S)
        assert not self.is_alive()
        return self._replies


Ask = Callable[[str, object], Asked]


@pytest.fixture
def hub() -> Hub:
    return Hub()


@pytest.fixture
def office(hub: Hub, tmp_path: Path) -> Iterator[Office]:
    with ExitStack() as stack:
        yield Office(hub, tmp_path / "place_recognition.sqlite", stack)


@pytest.fixture
def ask(hub: Hub) -> Iterator[Ask]:
    with closing(hub.join()) as bus:
        yield lambda key, message: Asked(
            bus, key, message if isinstance(message, bytes) else codec.encode(message)
        )


def test_a_request_is_held_until_there_is_a_job(office: Office, ask: Ask) -> None:
    asked = ask(keyexprs.JOB_LEASE, LeaseRequest("w"))
    office.step()
    assert asked.is_alive()
    office.dispatcher.add(job(0))
    office.step(seconds=1.0)
    lease = codec.decode(asked.replies()[0], Lease)
    assert (lease.job.id, lease.worker, lease.attempt) == (job(0).id, "w", 1)
    assert lease.log_id == LOG


def test_a_request_ends_empty_after_the_long_poll(office: Office, ask: Ask) -> None:
    asked = ask(keyexprs.JOB_LEASE, LeaseRequest("w"))
    office.step()
    office.step(seconds=5.0)
    assert asked.replies() == []


def test_an_outcome_is_acknowledged_once_it_is_durable(office: Office, ask: Ask) -> None:
    office.dispatcher.add(job(0))
    done = JobDone("w", rejection(0))
    first = ask(keyexprs.JOB_DONE, done)
    event: Any = office.inbox.take(PATIENCE_S)
    office.desk.handle(event, 0.0)
    # Not yet: a crash now would lose it.
    assert first.is_alive()
    office.desk.settle(0.0)
    assert codec.decode_upload_reply(first.replies()[0]) == Stored()
    second = ask(keyexprs.JOB_DONE, done)
    office.step()
    assert codec.decode_upload_reply(second.replies()[0]) == Duplicate()
    office.journal.close()
    with closing(Journal(office.path)) as again:
        assert again.recall(job(0).id).outcome == rejection(0)


def test_the_next_job_is_the_answer_to_an_outcome(office: Office, ask: Ask) -> None:
    office.dispatcher.add(job(0))
    office.dispatcher.add(job(1))
    asked = ask(keyexprs.JOB_LEASE, LeaseRequest("w"))
    office.step()
    first = codec.decode(asked.replies()[0], Lease).job
    done = JobDone("w", rejection(int(first.id, 16)), LOG, wants_next=True)
    asked = ask(keyexprs.JOB_DONE, done)
    office.step()
    second = codec.decode(asked.replies()[0], Lease)
    assert {first.id, second.job.id} == {job(0).id, job(1).id}
    assert office.dispatcher.leased == 1
    with closing(open_reader(office.path)) as reader:
        durable = reader.execute("SELECT id FROM job WHERE state = 'done'").fetchall()
    assert durable == [(first.id,)]
    # The answer was lost: the worker asks again, and its lease is given anew.
    again = ask(keyexprs.JOB_DONE, done)
    office.step()
    lease = codec.decode(again.replies()[0], Lease)
    assert (lease.job.id, lease.attempt) == (second.job.id, 1)


def test_without_a_next_job_an_outcome_is_acknowledged_at_once(office: Office, ask: Ask) -> None:
    office.dispatcher.add(job(0))
    asked = ask(keyexprs.JOB_DONE, JobDone("w", rejection(0), LOG, wants_next=True))
    office.step()
    assert codec.decode_upload_reply(asked.replies()[0]) == Stored()
    # Nor is it remembered that the worker wanted one.
    office.dispatcher.add(job(1))
    office.step(seconds=1.0)
    assert (office.dispatcher.pending, office.dispatcher.leased) == (1, 0)


def test_no_next_job_for_an_outcome_of_a_lost_log(office: Office, ask: Ask) -> None:
    office.dispatcher.add(job(0))
    asked = ask(keyexprs.JOB_DONE, JobDone("w", rejection(1), OTHER_LOG, wants_next=True))
    office.step()
    assert isinstance(codec.decode_upload_reply(asked.replies()[0]), Rejected)
    assert office.dispatcher.leased == 0


def test_a_worker_that_vanished_with_its_outcome_gets_no_next_job(office: Office, ask: Ask) -> None:
    office.dispatcher.add(job(0))
    office.desk.handle(WorkerGone("w"), 0.0)
    asked = ask(keyexprs.JOB_DONE, JobDone("w", rejection(1), LOG, wants_next=True))
    office.step()
    assert codec.decode_upload_reply(asked.replies()[0]) == Stored()
    assert office.dispatcher.leased == 0


def test_an_outcome_of_a_lost_log_is_refused_for_good(office: Office, ask: Ask) -> None:
    office.dispatcher.add(job(0))
    asked = ask(keyexprs.JOB_DONE, JobDone("w", rejection(0), OTHER_LOG))
    office.step()
    answer = codec.decode_upload_reply(asked.replies()[0])
    assert isinstance(answer, Rejected) and answer.code == "other_log"
    assert office.journal.recall(job(0).id).outcome is None
    asked = ask(keyexprs.JOB_DONE, JobDone("w", rejection(0), LOG))
    office.step()
    assert codec.decode_upload_reply(asked.replies()[0]) == Stored()


def test_a_worker_s_end_returns_its_job(office: Office, ask: Ask, hub: Hub) -> None:
    with closing(hub.join()) as worker:
        worker.declare_alive(keyexprs.worker_alive("w"))
        assert office.inbox.take(PATIENCE_S) == WorkerBack("w")
        office.dispatcher.add(job(0))
        asked = ask(keyexprs.JOB_LEASE, LeaseRequest("w"))
        office.step()
        asked.replies()
        assert office.dispatcher.leased == 1
    assert office.inbox.take(PATIENCE_S) == WorkerGone("w")


def test_a_dead_letter_is_published(office: Office, ask: Ask, hub: Hub) -> None:
    published = threading.Event()
    rejections: list[Rejection] = []

    def receive(_: str, payload: bytes) -> None:
        rejections.append(codec.decode(payload, Rejection))
        published.set()

    with closing(hub.join()) as viewer:
        viewer.subscribe(keyexprs.REJECTION, receive)
        office.dispatcher.add(job(0))
        ask(keyexprs.JOB_LEASE, LeaseRequest("w"))
        office.step()
        office.desk.handle(WorkerGone("w"), 0.0)
        office.desk.settle(0.0)
        assert published.wait(PATIENCE_S)
    assert [rejection.stage for rejection in rejections] == ["dead_letter"]


def test_a_dead_letter_can_be_sent_again(office: Office, ask: Ask) -> None:
    office.dispatcher.add(job(0))
    ask(keyexprs.JOB_LEASE, LeaseRequest("w"))
    office.step()
    office.desk.handle(WorkerGone("w"), 0.0)
    office.desk.settle(0.0)
    again = ask(keyexprs.job_retry(job(0).id), b"")
    office.step()
    assert codec.decode_upload_reply(again.replies()[0]) == Stored()
    assert office.dispatcher.pending == 1
    unknown = ask(keyexprs.job_retry("f" * 32), b"")
    office.step()
    answer = codec.decode_upload_reply(unknown.replies()[0])
    assert isinstance(answer, Rejected) and answer.code == "not_given_up"


def test_jobs_are_listed_with_their_state(office: Office, ask: Ask) -> None:
    for n in range(3):
        office.dispatcher.add(job(n))
    office.dispatcher.finish(rejection(1))
    asked = ask(keyexprs.JOB_LIST, JobRange(1))
    office.step()
    page = codec.decode(asked.replies()[0], JobPage)
    assert (page.total, page.first) == (3, 1)
    assert [r.state for r in page.records] == [JobState.DONE, JobState.PENDING]
    assert page.records[0].outcome == rejection(1)


@pytest.mark.parametrize("key", [keyexprs.JOB_LEASE, keyexprs.JOB_LIST])
def test_a_malformed_request_ends_empty(office: Office, ask: Ask, key: str) -> None:
    asked = ask(key, b"\x00garbage")
    office.step()
    assert asked.replies() == []
    assert office.desk.counters["malformed"] == 1


def test_a_malformed_outcome_is_refused_for_good(office: Office, ask: Ask) -> None:
    asked = ask(keyexprs.JOB_DONE, b"\x00garbage")
    office.step()
    answer = codec.decode_upload_reply(asked.replies()[0])
    assert isinstance(answer, Rejected) and answer.code == "malformed"


def test_a_full_inbox_sends_requests_away_at_once(office: Office, ask: Ask) -> None:
    while office.inbox.put("something", block=False):
        pass
    assert ask(keyexprs.JOB_LEASE, LeaseRequest("w")).replies() == []
    assert ask(keyexprs.JOB_DONE, JobDone("w", rejection(0))).replies() == []


def test_while_the_disk_takes_no_writes_nothing_is_lent_or_acknowledged(
    office: Office, ask: Ask
) -> None:
    office.dispatcher.add(job(0))
    office.set_writable(False)
    lease = ask(keyexprs.JOB_LEASE, LeaseRequest("w"))
    office.step()
    assert lease.replies() == []
    done = ask(keyexprs.JOB_DONE, JobDone("w", rejection(1)))
    office.step()
    assert done.replies() == []
    assert office.desk.counters == {"cannot_store.other": 1}
    done = ask(keyexprs.JOB_DONE, JobDone("w", rejection(2), wants_next=True))
    office.step()
    assert done.replies() == []
    assert office.desk.next_deadline_s() == RETRY_S
    office.step(seconds=RETRY_S)  # still so
    assert office.desk.next_deadline_s() == 2 * RETRY_S

    office.set_writable(True)
    office.step(seconds=RETRY_S)
    assert office.desk.counters == {}
    lease = ask(keyexprs.JOB_LEASE, LeaseRequest("w"))
    office.step()
    assert codec.decode(lease.replies()[0], Lease).attempt == 1
    done = ask(keyexprs.JOB_DONE, JobDone("w", rejection(1)))
    office.step()
    assert codec.decode_upload_reply(done.replies()[0]) == Duplicate()
    office.journal.close()
    with closing(Journal(office.path)) as again:
        assert again.recall(job(1).id).outcome == rejection(1)
