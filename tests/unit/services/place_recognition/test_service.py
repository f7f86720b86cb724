from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from covinz import codec
from covinz.bus import Query
from covinz.config import Config, PlaceRecognitionConfig, WorkerConfig
from covinz.keyframes import CameraNotFound, KeyframeNotFound
from covinz.log_follower import LogReset
from covinz.memory_bus import Hub
from covinz.service import Inbox, StatusRequest
from covinz.types import (
    Camera,
    Keyframe,
    KeyframeId,
    LeaseRequest,
    LogEntry,
    LogPage,
    LoopJob,
    Rejection,
    Status,
)
from services.place_recognition.calibrations import Calibrations
from services.place_recognition.desk import Desk, LeaseAsked
from services.place_recognition.dispatcher import Dispatcher
from services.place_recognition.journal import Journal
from services.place_recognition.service import (
    PAGES_AHEAD,
    PageGate,
    PlaceRecognition,
    recognizer_factory,
)

LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
OTHER_LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAW"
VISITS = [
    *(("a", seq, place) for seq, place in enumerate([0, 1, 2, 3, 4, 5])),
    *(("b", seq, place) for seq, place in enumerate([8, 4, 2, 9])),
    *(("c", seq, place) for seq, place in enumerate([1, 9, 5, 3])),
]


class NoCameras:
    """A store that has nothing."""

    def keyframe(self, keyframe_id: KeyframeId) -> Keyframe:
        raise KeyframeNotFound(f"no keyframe {keyframe_id}")

    def camera(self, camera_hash: str) -> Camera:
        raise CameraNotFound(f"no camera {camera_hash}")


class Question:
    """A query that remembers what became of it."""

    key = "covinz/test"

    def __init__(self, payload: bytes = b"") -> None:
        self.payload = payload
        self.replies: list[bytes] = []

    def reply(self, payload: bytes) -> None:
        self.replies.append(payload)

    def drop(self) -> None:
        self.replies.append(b"")

    def status(self) -> Status:
        return codec.decode(self.replies[0], Status)


class Process:
    """One life of the process, moved on step by step."""

    def __init__(
        self, world: Any, path: Path, stack: ExitStack, max_pending_jobs: int = 1000
    ) -> None:
        self.inbox = Inbox()
        config = PlaceRecognitionConfig(lease_s=60.0, max_pending_jobs=max_pending_jobs)
        journal = stack.enter_context(closing(Journal(path)))
        self.dispatcher: Dispatcher[Query] = Dispatcher(config, WorkerConfig(), journal)
        bus = stack.enter_context(closing(Hub().join()))
        self.service = PlaceRecognition(
            "pr",
            world.recognizer,
            self.dispatcher,
            Desk(self.dispatcher, journal, bus),
            PageGate(self.inbox, Calibrations(NoCameras())),
            clock_s=lambda: 0.0,
        )

    def step(self, *events: object) -> None:
        for event in events:
            self.inbox.put(event)
        self.service.step(self.inbox)

    def read(self, entries: Iterable[LogEntry]) -> None:
        """Process a whole log in one page."""
        entries = list(entries)
        self.step(LogReset(LOG), page(entries))
        while self.service.status().cursor < len(entries):
            self.step(StatusRequest(Question()))

    def jobs(self) -> list[LoopJob]:
        return [record.job for record in self.dispatcher.page(0).records]


def page(entries: Iterable[LogEntry], log_id: str = LOG) -> LogPage:
    entries = tuple(entries)
    return LogPage(log_id, 100, entries)


def rejection(job: LoopJob) -> Rejection:
    return Rejection(job.id, job.query, job.cand, "matches", 1.0, 30.0, "", 0.0)


Start = Callable[[], Process]


@pytest.fixture
def start(world: Any, tmp_path: Path) -> Iterator[Start]:
    """Starts the process; again as after a crash, over the same journal."""
    with ExitStack() as stack:

        def start() -> Process:
            stack.close()
            return Process(world, tmp_path / "place_recognition.sqlite", stack)

        yield start


@pytest.fixture
def entries(world: Any, log_of: Callable[[Iterable[Keyframe]], list[LogEntry]]) -> list[LogEntry]:
    return log_of(world.keyframe(*visit) for visit in VISITS)


def test_a_status_is_never_ahead_of_its_jobs(
    start: Start, entries: list[LogEntry], world: Any
) -> None:
    reference = world.recognizer()
    jobs_until = [0]
    for entry in entries:
        jobs_until.append(jobs_until[-1] + len(reference.process(entry)))
    assert jobs_until[-1] >= 5
    process = start()
    process.step(LogReset(LOG), page(entries))
    seen = []
    for _ in entries:
        question = Question()
        process.step(StatusRequest(question))
        status = question.status()
        assert status.pending == jobs_until[status.cursor]
        assert status.log_id == LOG
        seen.append(status.cursor)
    # One entry a step, and whoever asks is answered in between.
    assert seen == list(range(1, len(entries) + 1))


def test_workers_are_served_in_the_middle_of_a_page(start: Start, entries: list[LogEntry]) -> None:
    process = start()
    process.step(LogReset(LOG), page(entries))
    while not process.dispatcher.pending:
        process.step(StatusRequest(Question()))
    question = Question(codec.encode(LeaseRequest("w")))
    process.step(LeaseAsked(question))
    assert process.dispatcher.leased == 1 and question.replies[0]
    assert process.service.status().cursor < len(entries)


def test_pages_join(start: Start, entries: list[LogEntry], describe: Any, world: Any) -> None:
    reference = world.recognizer()
    process = start()
    process.step(LogReset(LOG), *(page([entry]) for entry in entries))
    while process.service.status().cursor < len(entries):
        process.step(page([]))
    want = [job for entry in entries for job in reference.process(entry)]
    assert describe(process.jobs()) == describe(want)


def test_a_hole_in_the_log_is_an_error(start: Start, entries: list[LogEntry]) -> None:
    process = start()
    with pytest.raises(RuntimeError, match="log entry 1 came instead of 0"):
        process.step(LogReset(LOG), page(entries[1:]))


def test_another_log_starts_over(start: Start, entries: list[LogEntry]) -> None:
    process = start()
    process.read(entries)
    assert process.service.status().pending
    for job in process.jobs():
        process.dispatcher.finish(rejection(job))
    # What is left of the old log's page goes with it.
    leftover = [LogEntry(len(entries), entries[0].item)]
    process.step(page(leftover), LogReset(OTHER_LOG), page(entries, OTHER_LOG))
    while process.service.status().cursor < len(entries):
        process.step(page([], OTHER_LOG))
    status = process.service.status()
    assert status.log_id == OTHER_LOG
    # The same jobs come again, and nothing is known of them.
    assert status.pending == len(process.jobs()) > 0
    assert status.counters.get("rejected.matches", 0) == 0


@given(data=st.data())
@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_jobs_and_outcomes_do_not_depend_on_crashes_or_order_of_completion(
    world: Any, entries: list[LogEntry], describe: Any, data: st.DataObject
) -> None:
    with TemporaryDirectory() as folder, ExitStack() as stack:
        path = Path(folder) / "place_recognition.sqlite"
        reference = world.recognizer()
        want = [job for entry in entries for job in reference.process(entry)]
        done: set[str] = set()
        for _ in range(data.draw(st.integers(0, 3), label="crashes")):
            process = Process(world, path, stack)
            cut = data.draw(st.integers(1, len(entries)), label="entries before the crash")
            process.read(entries[:cut])
            jobs = data.draw(st.permutations(process.jobs()), label="order of completion")
            for job in jobs[: data.draw(st.integers(0, len(jobs)))]:
                process.dispatcher.finish(rejection(job))
                done.add(job.id)
            process.step(page([]))
            stack.close()
        process = Process(world, path, stack)
        process.read(entries)
        assert describe(process.jobs()) == describe(want)
        records = process.dispatcher.page(0).records
        assert {r.job.id for r in records if r.outcome is not None} == done
        assert process.service.status().pending == len(want) - len(done)


def test_the_follower_is_held_back_after_two_pages(entries: list[LogEntry]) -> None:
    inbox = Inbox()
    gate = PageGate(inbox, Calibrations(NoCameras()))
    delivered = threading.Semaphore(0)

    def follow() -> None:
        gate.deliver(LogReset(LOG))
        for entry in entries:
            gate.deliver(page([entry]))
            delivered.release()

    follower = threading.Thread(target=follow, daemon=True)
    follower.start()
    for _ in range(PAGES_AHEAD):
        assert delivered.acquire(timeout=20)
    assert not delivered.acquire(timeout=0.05)
    gate.page_done()
    assert delivered.acquire(timeout=20)
    assert not delivered.acquire(timeout=0.05)
    # At the end nobody waits for a page to be worked off.
    gate.open_for_ever()
    follower.join(20)
    assert not follower.is_alive()


def test_the_shipped_vocabulary_works_with_the_defaults(world: Any) -> None:
    recognizer = recognizer_factory(Config(), lambda camera_hash: None)()
    assert recognizer.process(LogEntry(0, world.keyframe("a", 0, 0))) == []
    assert recognizer.counters["indexed"] == 1


def test_what_was_logged_before_waits_in_the_log_and_news_are_shed(
    world: Any, tmp_path: Path, entries: list[LogEntry], start: Start
) -> None:
    everything = start()
    everything.read(entries)
    wanted = [job.id for job in everything.jobs()]
    limit, old = 2, len(entries) - 2
    assert len(wanted) > 2 * limit
    with ExitStack() as stack:
        process = Process(world, tmp_path / "other.sqlite", stack, limit)
        process.step(LogReset(LOG), LogPage(LOG, old, tuple(entries[:old])))
        for _ in range(len(entries)):
            process.step(StatusRequest(Question()))
        # Nobody works: the log is read no further, and nothing is given up.
        status = process.service.status()
        assert status.cursor < old and status.pending >= limit
        assert "rejected.shed" not in status.counters
        while process.service.status().cursor < old:
            for job in process.jobs():
                process.dispatcher.finish(rejection(job))
            process.step(StatusRequest(Question()))
        made = len(process.jobs())
        assert [job.id for job in process.jobs()] == wanted[:made]
        process.step(LogPage(LOG, len(entries), tuple(entries[old:])))
        while process.service.status().cursor < len(entries):
            process.step(StatusRequest(Question()))
        # News come whether anybody works or not; all jobs are there, some of them given up.
        assert [job.id for job in process.jobs()] == wanted
        status = process.service.status()
        assert status.pending <= limit
        shed, done = status.counters["rejected.shed"], status.counters["rejected.matches"]
        assert shed > 0 and shed + done + status.pending == len(wanted)
