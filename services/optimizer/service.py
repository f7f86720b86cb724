"""The optimizer as a process: one thread owns the maps, another one optimises.

Order of things, so that nothing is lost and the status is never ahead of the truth: a loop is
durable and among the inputs before it is acked; an optimisation starts when something is stale,
none runs and the last one is long enough ago; a correction is durable before it is published.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from typing import Protocol

from covinz import codec
from covinz.bus import Bus, Query
from covinz.config import OptimizerConfig
from covinz.damage import rebuildable
from covinz.durable import DamagedFile
from covinz.log_follower import LogFollower, LogReset
from covinz.logs import about
from covinz.service import Context, StatusRequest
from covinz.types import (
    Duplicate,
    Gap,
    LogPage,
    LogView,
    LoopClosure,
    RetryAfter,
    SegmentId,
    Status,
    Stored,
)
from services.optimizer.admission import admit
from services.optimizer.announcements import Announcements
from services.optimizer.components import Component
from services.optimizer.doors import (
    RETRY_AFTER_S,
    Asked,
    LoopBrought,
    answer_question,
    open_doors,
    reply,
)
from services.optimizer.loop_store import LoopStore, StoreUnavailable
from services.optimizer.lost_loops import LoopsFound, LostLoops
from services.optimizer.maps import Maps
from services.optimizer.optimisation import MapEstimate, Optimise, optimise
from services.optimizer.pace import Pace
from services.optimizer.unsent import Unsent
from services.optimizer.worker import OptimisationCrashed, OptimisationThread, Optimised

logger = logging.getLogger(__name__)

# Events taken together, so that loops share a commit.
EVENTS_PER_STEP = 256
# Of the loops that came last it is known without reading them that they are durable.
REMEMBERED_LOOPS = 1024


class Submit(Protocol):
    """Starts a job whose result comes back as an event; `OptimisationThread.submit`."""

    def __call__(self, components: tuple[Component, ...], epoch: int) -> None:
        """Queue a job."""


def run(context: Context, run_one: Optimise = optimise) -> None:
    """Keep the maps until `context.inbox` raises Stopped.

    Args:
        context: What the process is given.
        run_one: Optimises one map.

    Raises:
        DurableFileError: If the store cannot be used.
        StoreUnavailable: If it cannot be noted that another log follows.
    """
    config, machine, deliver = context.config.optimizer, context.machine, context.inbox.put

    def finish(event: object) -> None:
        if isinstance(event, Optimised):
            context.telemetry.observe("optimizer_optimisation", event.duration_ms / 1e3)
        deliver(event)

    optimising = context.watch.work("an optimisation", context.config.health.optimisation_s)

    def run_limited(component: Component, config: OptimizerConfig) -> MapEstimate:
        with optimising:
            return run_one(component, config)

    with ExitStack() as stack:
        path = context.data_dir / "optimizer.sqlite"
        store = rebuildable(path, lambda: LoopStore(path), DamagedFile)
        stack.enter_context(closing(store))
        thread = stack.enter_context(
            closing(OptimisationThread(config, finish, machine, run_limited))
        )
        lost_loops = LostLoops(context.bus, deliver, machine)
        stack.callback(lost_loops.close)
        optimizer = Optimizer(
            store,
            context.bus,
            config,
            thread.submit,
            context.instance,
            machine.monotonic_s,
            machine.now_ns,
            lost_loops.look,
        )
        stack.enter_context(open_doors(context.bus, context.inbox))
        follower = LogFollower(context.bus, LogView.POSE, deliver, machine=machine)
        stack.enter_context(closing(follower))
        # Keyframes are kept in memory only, so the log is always read from its beginning.
        follower.start(0, "", store.seen)
        while True:
            first = context.inbox.take(optimizer.patience_s())
            events = [] if first is None else [first, *context.inbox.drain(EVENTS_PER_STEP - 1)]
            optimizer.handle(events)


class Optimizer:
    """The state of the process and how events change it; for one thread.

    Args:
        store: Loops, revision and corrections.
        bus: To publish corrections.
        config: Section `optimizer`.
        submit: Starts a job.
        instance: Name in the status.
        clock_s: Monotonic time.
        now_ns: Time since the Unix epoch, for stamps.
        look_for_loops: Makes the accepted loops of a log come as LoopsFound; None: they never do.
    """

    def __init__(
        self,
        store: LoopStore,
        bus: Bus,
        config: OptimizerConfig,
        submit: Submit,
        instance: str,
        clock_s: Callable[[], float] = time.monotonic,
        now_ns: Callable[[], int] = time.time_ns,
        look_for_loops: Callable[[str], object] | None = None,
    ) -> None:
        self._store = store
        self._config = config
        self._submit = submit
        self._instance = instance
        self._clock_s = clock_s
        self._look_for_loops = look_for_loops
        # The journal may have loops that are not here; and it may have all that there are.
        self._may_lack_loops = self._may_lack_all = False
        self._maps = Maps(config)
        self._counters: Counter[str] = Counter(faulty_loops=len(store.faults()))
        self._last_job_ms = 0.0
        self._log_id, self._cursor, self._head = "", 0, 0
        self._unsent = Unsent(store)
        self._announcements = Announcements(store, self._unsent, bus, config, now_ns)
        # As they came; workers bring every loop twice, and few wait in between.
        self._durable: dict[bytes, None] = {}
        self._epoch = 0
        self._running = False
        self._pace = Pace(config)
        self._quiet_since_s = clock_s()
        for loop in store.loops():
            self._maps.add_loop(loop)

    # --- events ------------------------------------------------------------------------------

    def handle(self, events: Sequence[object]) -> None:
        """Work off events, then optimise what needs it and answer what was asked."""
        self._take_loops([event.query for event in events if isinstance(event, LoopBrought)])
        for event in events:
            match event:
                case LogReset(log_id):
                    self._start_over(log_id)
                case LogPage():
                    self._read(event)
                case Optimised():
                    self._finish(event)
                case LoopsFound():
                    self._take_found(event)
                case OptimisationCrashed(error):
                    raise error
        self._optimise()
        if self._caught_up:
            self._announcements.introduce(self._maps, self._clock_s())
        self._announcements.send(self._clock_s())
        for event in events:
            match event:
                case StatusRequest():
                    event.answer(self.status())
                case Asked(query):
                    answer_question(query, self._maps, self._announcements.last)

    def patience_s(self) -> float | None:
        """How long to wait for events; None: until there is one."""
        due_s = (self._unsent.retry_at_s, self._optimisation_due_s())
        wake_s = [at_s for at_s in due_s if at_s is not None]
        return max(0.0, min(wake_s) - self._clock_s()) if wake_s else None

    def status(self) -> Status:
        """Dirty until the maps are what decision 0003 makes of the log so far and the loops."""
        counters = {
            **self._counters,
            **self._unsent.counters,
            "maps": len(self._maps.map_list().maps),
            "keyframes": self._maps.num_keyframes,
            "loops": self._maps.num_loops,
            "jumps": self._announcements.jumps,
            "last_optimisation_ms": self._last_job_ms,
            "map_revision": self._store.revision,
        }
        return Status(
            service="optimizer",
            instance=self._instance,
            log_id=self._log_id,
            cursor=self._cursor,
            pending=len(self._maps.pending),
            leased=0,
            dirty=self._running
            or self._may_lack_loops
            or bool(self._maps.stale(with_keyframes=True) or self._unsent),
            counters={name: float(value) for name, value in sorted(counters.items())},
        )

    # --- loops -------------------------------------------------------------------------------

    def _take_loops(self, queries: Sequence[Query]) -> None:
        """Make loops durable with one commit, take them among the inputs, then ack them."""
        admitted: list[tuple[Query, LoopClosure]] = []
        for query in queries:
            if query.payload in self._durable:
                reply(query, Duplicate())
                continue
            verdict = admit(query.payload)
            if isinstance(verdict, LoopClosure):
                if self._is_of_this_log(verdict):
                    admitted.append((query, verdict))
                else:
                    # The worker may know of a new log before us; it asks ingest which one there is.
                    self._counters["loops_of_other_logs"] += 1
                    reply(query, RetryAfter(RETRY_AFTER_S, f"not of log {self._store.log_id}"))
            else:
                self._counters["rejected_loops"] += 1
                logger.warning("rejected a loop: %s: %s", verdict.code, verdict.reason)
                reply(query, verdict)
        if not admitted:
            return
        try:
            new = self._store.add([(loop.job_id, query.payload) for query, loop in admitted])
        except StoreUnavailable as error:
            self._unsent.failed(error, self._clock_s())
            for query, _ in admitted:
                reply(query, RetryAfter(RETRY_AFTER_S, error.trouble.words))
            return
        for (query, loop), is_new in zip(admitted, new, strict=True):
            if is_new:
                self._maps.add_loop(loop)
                extra = about(keyframe=loop.query, job=loop.job_id)
                logger.info("loop %s: %s sees %s", loop.job_id, loop.query, loop.cand, extra=extra)
            self._remember(query.payload)
            reply(query, Stored() if is_new else Duplicate())

    def _remember(self, payload: bytes) -> None:
        self._durable[payload] = None
        if len(self._durable) > REMEMBERED_LOOPS:
            del self._durable[next(iter(self._durable))]

    def _take_found(self, found: LoopsFound) -> None:
        """Loops of the journal: most are here already."""
        if found.log_id != self._log_id:
            return
        if not found.loops:
            self._may_lack_loops = self._may_lack_all = False
            return
        payloads = [(loop.job_id, codec.encode(loop)) for loop in found.loops]
        try:
            new = self._store.add(payloads)
        except StoreUnavailable as error:
            self._unsent.failed(error, self._clock_s())
            if self._look_for_loops is not None:
                self._look_for_loops(self._log_id)
            return
        lost = [loop for loop, is_new in zip(found.loops, new, strict=True) if is_new]
        for loop in lost:
            self._maps.add_loop(loop)
        if lost:
            self._counters["recovered_loops"] += len(lost)
            logger.warning("%d accepted loops come from the journal of jobs", len(lost))

    def _is_of_this_log(self, loop: LoopClosure) -> bool:
        """Whether the loop belongs to the log that the store is of; it may not say."""
        return self._store.log_id != "" and loop.log_id in ("", self._store.log_id)

    # --- the log -----------------------------------------------------------------------------

    def _start_over(self, log_id: str) -> None:
        """Read the log from its beginning; another log has other loops."""
        logger.info("reading log %s from its beginning", log_id)
        if self._look_for_loops is not None:
            self._may_lack_loops = True
            self._may_lack_all = self._may_lack_all or self._store.log_id != log_id
            self._look_for_loops(log_id)
        is_other = self._store.log_id != log_id
        if is_other:
            self._store.begin_log(log_id)
            self._durable.clear()
        self._announcements.begin_log(is_other)
        self._counters["faulty_loops"] = len(self._store.faults())
        self._maps.clear()
        for loop in self._store.loops():
            self._maps.add_loop(loop)
        self._log_id, self._cursor, self._head = log_id, 0, 0
        self._counters["gaps"] = 0
        self._epoch += 1

    def _read(self, page: LogPage) -> None:
        if page.log_id != self._log_id:
            raise RuntimeError(f"a page of log {page.log_id} while reading {self._log_id}")
        self._head = max(self._head, page.head)
        if page.chain and page.entries:
            self._store.note_seen(page.mark)
        for entry in page.entries:
            if entry.log_index != self._cursor:
                raise RuntimeError(f"log entry {entry.log_index} came instead of {self._cursor}")
            self._cursor += 1
            if isinstance(entry.item, Gap):
                self._counters["gaps"] += 1
                continue
            if self._maps.add_keyframe(entry.log_index, entry.item, self._store.revision):
                self._announcements.expect(entry.item.id.segment)
            self._quiet_since_s = self._clock_s()

    @property
    def _caught_up(self) -> bool:
        """Half a log would give half a map, and corrections from it; so would no loops."""
        return self._cursor == self._head and not self._may_lack_all

    # --- optimisation ------------------------------------------------------------------------

    def _optimisation_due_s(self) -> float | None:
        """When to see to what is stale; None: not before something happens."""
        if self._running or not self._caught_up:
            return None
        if self._clock_s() < self._pace.rests_until_s:
            # With every loop that comes meanwhile it would be another question, and a long one.
            return self._pace.rests_until_s
        if self._maps.stale(with_keyframes=False):
            return self._pace.rests_until_s
        return self._settled_s if self._maps.stale(with_keyframes=True) else None

    @property
    def _settled_s(self) -> float:
        return self._quiet_since_s + self._config.settle_s

    def _optimise(self) -> None:
        """Start a job when something is stale, none runs, and the last one is long enough ago."""
        due_s, now_s = self._optimisation_due_s(), self._clock_s()
        if due_s is None or now_s < due_s:
            return
        stale = self._maps.stale(with_keyframes=now_s >= self._settled_s)
        self._running = True
        self._pace.begin(now_s)
        self._submit(tuple(map(self._maps.component, stale)), self._epoch)

    def _finish(self, done: Optimised) -> None:
        """Publish what a job found as far as it is still true; what is not stays stale."""
        self._running = False
        self._pace.end(self._clock_s())
        if done.epoch != self._epoch:
            return
        self._counters["optimisations"] += 1
        self._last_job_ms = done.duration_ms
        if done.faults:
            self._unsent.write(lambda: self._store.mark(done.faults), self._clock_s())
            for fault in done.faults:
                extra = about(job=fault.job_id)
                logger.error("loop %s is left out: %s", fault.job_id, fault.reason, extra=extra)
                self._counters["faulty_loops"] += 1
                self._maps.remove_loop(fault.job_id)
        revision = self._store.revision + 1
        changed: set[SegmentId] = set()
        for estimate in done.estimates:
            self._counters["not_converged"] += not estimate.converged
            if self._maps.apply(estimate, revision):
                changed |= set(estimate.placements)
            else:
                self._counters["outdated_optimisations"] += 1
        if changed:
            self._announcements.prepare(self._maps, revision, changed, self._clock_s())
