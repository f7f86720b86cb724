"""Questions to a running server: how far is it, which maps, which jobs, why no loop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from covinz import codec, keyexprs
from covinz.bus import Bus
from covinz.types import (
    Gap,
    JobPage,
    JobRange,
    JobRecord,
    LogPage,
    LogRange,
    LogView,
    MapList,
    MapSnapshot,
    MapSummary,
    Status,
)

# Between two looks at the status of a system that is still at work.
POLL_S = 0.2


class ServerUnavailable(RuntimeError):
    """A part of the server did not answer; the message names it."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the server is with what its log holds.

    Attributes:
        head: Entries in the log.
        looked_up: Entries that place recognition has processed.
        mapped: Entries that the optimizer has processed.
        open_jobs: Jobs pending or leased.
        busy_workers: Loop solvers at work; also on a job that counts as given up, whose outcome
            is taken when it comes.
        dirty: The optimizer has accepted something that its maps do not show yet.
        missing: Services that did not answer.
    """

    head: int
    looked_up: int
    mapped: int
    open_jobs: int
    busy_workers: int
    dirty: bool
    missing: tuple[str, ...]

    @property
    def idle(self) -> bool:
        """Nothing is left to do for the log as it is."""
        done = self.looked_up == self.head == self.mapped
        at_work = self.open_jobs or self.busy_workers or self.dirty
        return done and not at_work and not self.missing

    def __str__(self) -> str:
        """What is left to do, for a person."""
        left = [
            (self.head - self.looked_up, "keyframes to look up"),
            (self.head - self.mapped, "keyframes to map"),
            (self.open_jobs, "jobs open"),
            (self.busy_workers, "loop solvers at work"),
        ]
        parts = [f"{count} {what}" for count, what in left if count > 0]
        parts += ["maps to optimise"] if self.dirty else []
        parts += [f"missing: {name}" for name in self.missing]
        return ", ".join(parts) or "nothing left to do"


def statuses(bus: Bus, service: str = "*", timeout_s: float = 5.0) -> list[Status]:
    """Status of every process that answers in time, sorted by service and instance."""
    found = [
        codec.decode(reply, Status)
        for reply in bus.ask(keyexprs.service_status(service, "*"), timeout_s=timeout_s)
    ]
    return sorted(found, key=lambda status: (status.service, status.instance))


def progress(bus: Bus) -> Progress:
    """How far the server is.

    The services are asked in the order in which work flows through them, so that work which
    leaves one while we ask is seen in the next.
    """
    by_name: dict[str, Status] = {}
    busy_workers = 0
    for name in ("ingest", "place_recognition", "loop_solver", "optimizer"):
        for status in statuses(bus, name):
            if name == "loop_solver":
                busy_workers += status.leased
            else:
                by_name[name] = status
    ingest, recognition = by_name.get("ingest"), by_name.get("place_recognition")
    optimizer = by_name.get("optimizer")
    missing = [n for n in ("ingest", "place_recognition", "optimizer") if n not in by_name]
    log_ids = {status.log_id for status in by_name.values()}
    if not missing and len(log_ids) > 1:
        missing = ["a common log"]
    return Progress(
        head=ingest.cursor if ingest else 0,
        looked_up=recognition.cursor if recognition else 0,
        mapped=optimizer.cursor if optimizer else 0,
        open_jobs=recognition.pending + recognition.leased if recognition else 0,
        busy_workers=busy_workers,
        dirty=optimizer.dirty if optimizer else False,
        missing=tuple(missing),
    )


def wait_idle(
    bus: Bus,
    timeout_s: float | None = None,
    on_progress: Callable[[Progress], None] = lambda _: None,
    cancelled: threading.Event | None = None,
) -> Progress:
    """Wait until the server has nothing left to do.

    Raises:
        TimeoutError: If it is still at work after `timeout_s`, or `cancelled` was set.
    """
    deadline = None if timeout_s is None else time.monotonic() + timeout_s
    pause = cancelled or threading.Event()
    while True:
        now = progress(bus)
        on_progress(now)
        if now.idle:
            return now
        late = deadline is not None and time.monotonic() > deadline
        if pause.wait(POLL_S) or late:
            raise TimeoutError(f"the server is not idle: {now}")


def maps(bus: Bus) -> tuple[MapSummary, ...]:
    """Every map, oldest first; raises ServerUnavailable when the optimizer does not answer."""
    return codec.decode(_one(bus, keyexprs.MAP_LIST, b"", "optimizer"), MapList).maps


def snapshot(bus: Bus, map_id: str) -> MapSnapshot:
    """One map with its graph; raises ServerUnavailable when there is no answer."""
    return codec.decode(_one(bus, keyexprs.map_snapshot(map_id), b"", "optimizer"), MapSnapshot)


def snapshots(bus: Bus) -> list[MapSnapshot]:
    """All maps with their graphs, oldest first."""
    return [snapshot(bus, summary.map_id) for summary in maps(bus)]


def jobs(bus: Bus) -> Iterator[JobRecord]:
    """Every job with its outcome, in order of creation."""
    first, total = 0, 1
    while first < total:
        question = codec.encode(JobRange(first))
        page = codec.decode(_one(bus, keyexprs.JOB_LIST, question, "place_recognition"), JobPage)
        yield from page.records
        first, total = first + len(page.records), page.total
        if not page.records:
            return


def gaps(bus: Bus) -> Iterator[Gap]:
    """Every gap in the log: keyframes that will never come, and why; in its order."""
    first, head = 0, 1
    while first < head:
        question = codec.encode(LogRange(first, LogView.POSE))
        page = codec.decode(_one(bus, keyexprs.LOG_RANGE, question, "ingest"), LogPage)
        yield from (entry.item for entry in page.entries if isinstance(entry.item, Gap))
        first, head = first + len(page.entries), page.head
        if not page.entries:
            return


def _one(bus: Bus, key: str, payload: bytes, service: str) -> bytes:
    replies: Sequence[bytes] = bus.ask(key, payload)
    if not replies:
        raise ServerUnavailable(f"{service} does not answer on {key}")
    return replies[0]
