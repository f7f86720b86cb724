"""Place recognition as a process: one thread owns the index, the jobs and the journal.

Log pages are worked off entry by entry, and between two entries everything else in the inbox is
answered: workers never wait for a replay. The jobs of an entry are pending in the same step in
which the cursor moves past it, so a status is never ahead of its jobs.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, closing

from covinz.bus import Query
from covinz.config import Config
from covinz.damage import rebuildable
from covinz.durable import DamagedFile
from covinz.keyframes import RemoteKeyframeStore
from covinz.log_follower import LogFollower, LogReset
from covinz.machine import THIS_MACHINE, Machine
from covinz.service import Context, Inbox, StatusRequest
from covinz.types import Camera, LogEntry, LogPage, LogView, Status
from services.place_recognition.calibrations import Calibrations
from services.place_recognition.dead_letters import DeadLetters
from services.place_recognition.desk import (
    Desk,
    JobsAsked,
    LeaseAsked,
    LoopsAsked,
    OutcomeBrought,
    RetryAsked,
    WorkerBack,
    WorkerGone,
    open_desk,
)
from services.place_recognition.dispatcher import Dispatcher
from services.place_recognition.index import load_vocabulary
from services.place_recognition.journal import Journal
from services.place_recognition.places import Places
from services.place_recognition.recognizer import Recognizer

logger = logging.getLogger(__name__)

# Requests answered between two log entries.
REQUESTS_PER_STEP = 64
# Log pages in memory: one is worked off while the next comes in.
PAGES_AHEAD = 2


def run(context: Context) -> None:
    """Follow the log and lend jobs until `context.inbox` raises Stopped.

    Raises:
        ConfigError: If there is no usable vocabulary.
        DurableFileError: If the journal cannot be used.
    """
    config, machine = context.config, context.machine
    store = RemoteKeyframeStore(context.bus, capacity=1)
    calibrations = Calibrations(store, machine=machine)
    new_recognizer = recognizer_factory(config, calibrations.camera)
    gate = PageGate(context.inbox, calibrations, machine)
    with ExitStack() as stack:
        path = context.data_dir / "place_recognition.sqlite"
        journal = rebuildable(path, lambda: Journal(path), DamagedFile)
        stack.enter_context(closing(journal))
        dispatcher: Dispatcher[Query] = Dispatcher(config.place_recognition, config.worker, journal)
        dead_letters = DeadLetters(store, config.loop_solver, context.data_dir, machine)
        stack.callback(dead_letters.close)
        desk = Desk(dispatcher, journal, context.bus, dead_letters.save)
        service = PlaceRecognition(
            context.instance, new_recognizer, dispatcher, desk, gate, machine.monotonic_s
        )
        stack.enter_context(open_desk(context.bus, context.inbox))
        follower = LogFollower(context.bus, LogView.FULL, gate.deliver, machine=machine)
        stack.enter_context(closing(follower))
        stack.callback(gate.open_for_ever)
        # The index lives in memory only, so the log is always read from its beginning.
        follower.start(0, "", journal.seen)
        while True:
            service.step(context.inbox)


def recognizer_factory(
    config: Config, camera: Callable[[str], Camera | None]
) -> Callable[[], Recognizer]:
    """Makes empty recognizers; the vocabularies are read once.

    Args:
        config: All of it: also the solver's part says what a job is.
        camera: Gives the calibrations of the log's keyframes by their hashes.

    Raises:
        ConfigError: If a vocabulary or an index's options cannot be used.
    """
    kinds = config.loop_solver.kinds
    vocabularies = {kind: load_vocabulary(config.place_recognition, kind) for kind in kinds}
    Places(config.place_recognition, kinds, vocabularies)

    def make() -> Recognizer:
        places = Places(config.place_recognition, kinds, vocabularies)
        return Recognizer(config.place_recognition, config.loop_solver, places, camera)

    return make


class PageGate:
    """Lets the log's follower run ahead by a few pages only; other events pass freely."""

    def __init__(
        self, inbox: Inbox, calibrations: Calibrations, machine: Machine = THIS_MACHINE
    ) -> None:
        self._inbox = inbox
        self._calibrations = calibrations
        self._changed = machine.condition()  # guards what follows
        self._places = PAGES_AHEAD
        self._open = False

    def deliver(self, event: LogReset | LogPage) -> None:
        """For the follower's thread: waits until there is room for a page, and calibrations."""
        if isinstance(event, LogPage):
            with self._changed:
                self._changed.wait_for(lambda: self._open or self._places)
                self._places -= 1
            self._calibrations.fetch(event)
        else:
            self._calibrations.forget_missing()
        self._inbox.put(event)

    def page_done(self) -> None:
        """A page has been worked off."""
        with self._changed:
            self._places += 1
            self._changed.notify_all()

    def open_for_ever(self) -> None:
        """Let a waiting follower go: the service ends."""
        with self._changed:
            self._open = True
            self._changed.notify_all()
        self._calibrations.close()


class PlaceRecognition:
    """The state of the process and how events change it."""

    def __init__(
        self,
        instance: str,
        new_recognizer: Callable[[], Recognizer],
        dispatcher: Dispatcher[Query],
        desk: Desk,
        gate: PageGate,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._instance = instance
        self._new_recognizer = new_recognizer
        self._recognizer = new_recognizer()
        self._dispatcher = dispatcher
        self._desk = desk
        self._gate = gate
        self._clock_s = clock_s
        self._log_id = ""
        self._cursor = 0
        # Where the log ended when it was first looked at.
        self._old_head: int | None = None
        self._pages: deque[deque[LogEntry]] = deque()

    def step(self, inbox: Inbox) -> None:
        """Handle some of the inbox and one log entry; waits when there is nothing to do."""
        first = inbox.take(self._patience_s())
        events = [] if first is None else [first, *inbox.drain(REQUESTS_PER_STEP - 1)]
        for event in events:
            self._handle(event)
        # Who asked is answered before an entry is looked up, which takes longer than all of this.
        self._desk.settle(self._clock_s())
        if self._pages and not self._holds_back:
            self._process_entry()
            self._desk.settle(self._clock_s())

    def status(self) -> Status:
        """Cursor, open jobs, and what was found, skipped, accepted and rejected."""
        counters = {
            **self._recognizer.counters,
            **self._dispatcher.counters,
            **self._desk.counters,
            "waiting": self._recognizer.waiting,
        }
        return Status(
            service="place_recognition",
            instance=self._instance,
            log_id=self._log_id,
            cursor=self._cursor,
            pending=self._dispatcher.pending,
            leased=self._dispatcher.leased,
            dirty=False,
            counters={name: float(count) for name, count in sorted(counters.items())},
        )

    @property
    def _holds_back(self) -> bool:
        """What was logged before can wait in the log: no job of it is given up for being many."""
        is_old = self._old_head is not None and self._cursor < self._old_head
        return is_old and self._dispatcher.is_full

    def _patience_s(self) -> float | None:
        if self._pages and not self._holds_back:
            return 0.0
        deadline_s = self._desk.next_deadline_s()
        return None if deadline_s is None else max(0.0, deadline_s - self._clock_s())

    def _handle(self, event: object) -> None:
        match event:
            case StatusRequest():
                event.answer(self.status())
            case LogReset(log_id):
                self._start_over(log_id)
            case LogPage(entries=entries, head=head):
                if self._old_head is None:
                    self._old_head = head
                if event.chain and entries:
                    self._dispatcher.know(event.mark)
                if entries:
                    self._pages.append(deque(entries))
                else:
                    self._gate.page_done()
            case (
                LeaseAsked()
                | OutcomeBrought()
                | JobsAsked()
                | LoopsAsked()
                | RetryAsked()
                | WorkerGone()
                | WorkerBack()
            ):
                self._desk.handle(event, self._clock_s())

    def _start_over(self, log_id: str) -> None:
        logger.info("reading log %s from its beginning", log_id)
        for _ in self._pages:
            self._gate.page_done()
        self._pages.clear()
        self._recognizer = self._new_recognizer()
        self._dispatcher.reset(log_id)
        self._log_id, self._cursor, self._old_head = log_id, 0, None

    def _process_entry(self) -> None:
        page = self._pages[0]
        entry = page.popleft()
        if not page:
            self._pages.popleft()
            self._gate.page_done()
        if entry.log_index != self._cursor:
            raise RuntimeError(f"log entry {entry.log_index} came instead of {self._cursor}")
        for job in self._recognizer.process(entry):
            logger.debug("candidate %s for %s, score %.1f", job.cand, job.query, job.score)
            self._dispatcher.add(job)
        if self._old_head is not None and self._cursor >= self._old_head:
            self._dispatcher.shed()
        self._cursor += 1
