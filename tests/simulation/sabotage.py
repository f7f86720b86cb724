"""Defects to put in on purpose: a simulation that does not find them is not worth much."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from covinz import codec, keyexprs
from covinz.bus import Bus, Closable, Query
from covinz.memory_bus import intersects
from covinz.service import Context
from covinz.types import (
    Duplicate,
    LogPage,
    LogRange,
    LoopClosure,
    LoopPage,
    Rejected,
    Stored,
)
from services.ingest import service as ingest
from services.ingest.admission import AdmittedCamera, AdmittedUpload
from services.ingest.keyframe_log import KeyframeLog
from tests.simulation.simulation import Sabotage

STORED = codec.encode(Stored())


class _Between:
    """A bus that passes everything on."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)


class _AckFirst(_Between):
    """Answers certain questions with "stored" before anybody has stored anything."""

    def __init__(self, bus: Bus, key: str) -> None:
        super().__init__(bus)
        self._key = key

    def answer(self, key: str, callback: Callable[[Query], None]) -> Closable:
        def ack_first(query: Query) -> None:
            query.reply(STORED)
            callback(query)

        return self._bus.answer(key, ack_first if key == self._key else callback)


class _HopeForTheBest(_Between):
    """Sends certain messages once and takes them for delivered."""

    def __init__(self, bus: Bus, key: str) -> None:
        super().__init__(bus)
        self._key = key

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        if not intersects(self._key, key):
            return self._bus.ask(key, payload, timeout_s)
        self._bus.ask(key, payload, 0.0)
        return [STORED]


class _EarlyCursor(_Between):
    """Remembers, over restarts, how much of the log has come, not how much was worked off."""

    def __init__(self, bus: Bus, cursor: list[int]) -> None:
        super().__init__(bus)
        self._cursor = cursor

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        if key != keyexprs.LOG_RANGE:
            return self._bus.ask(key, payload, timeout_s)
        asked = codec.decode(payload, LogRange)
        asked = dataclasses.replace(asked, start=max(asked.start, self._cursor[0]))
        replies = self._bus.ask(key, codec.encode(asked), timeout_s)
        for reply in replies:
            self._cursor[0] += len(codec.decode(reply, LogPage).entries)
        return replies


class _EveryLoopIsNew(_Between):
    """Gives a loop another name each time it comes, so that nobody knows it again."""

    def __init__(self, bus: Bus) -> None:
        super().__init__(bus)
        self._times: Counter[str] = Counter()

    def answer(self, key: str, callback: Callable[[Query], None]) -> Closable:
        def rename(query: Query) -> None:
            loop = codec.decode(query.payload, LoopClosure)
            self._times[loop.job_id] += 1
            if (times := self._times[loop.job_id]) > 1:
                name = hashlib.blake2b(f"{loop.job_id} {times}".encode(), digest_size=16)
                loop = dataclasses.replace(loop, job_id=name.hexdigest())
                query.payload = codec.encode(loop)  # type: ignore[misc]
            callback(query)

        return self._bus.answer(key, rename if key == keyexprs.LOOP else callback)


class _NoJournal(_Between):
    """Does not see the loops of the journal of jobs."""

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        replies = self._bus.ask(key, payload, timeout_s)
        if key != keyexprs.JOB_LOOPS:
            return replies
        pages = [codec.decode(reply, LoopPage) for reply in replies]
        return [codec.encode(dataclasses.replace(page, loops=())) for page in pages]


class _LogWithoutMemory(KeyframeLog):
    """Takes every upload for a new one."""

    def append(
        self, batch: Sequence[AdmittedUpload | AdmittedCamera]
    ) -> list[Stored | Duplicate | Rejected]:
        with self._file.transaction() as db:
            db.execute("DROP INDEX IF EXISTS entry_id")
            # What is there gets a name that nobody asks for while the new uploads are stored.
            db.execute("UPDATE entry SET is_gap = is_gap + 2")
        try:
            return super().append(batch)
        finally:
            with self._file.transaction() as db:
                db.execute("UPDATE entry SET is_gap = is_gap - 2 WHERE is_gap > 1")


def _run_without_memory(context: Context) -> None:
    ingest.run(context, open_log=_LogWithoutMemory)


def _only(name: str, change: Callable[[Bus], Any], process: str, bus: Bus) -> Any:
    return change(bus) if process.startswith(name) else bus


def _wrapping(name: str, change: Callable[[Bus], Any]) -> Sabotage:
    return Sabotage(wrap=partial(_only, name, change))


def _without_journal(name: str, change: Callable[[Bus], Any]) -> Sabotage:
    """The journal of jobs would heal it with the optimizer's next start."""

    def wrap(process: str, bus: Bus) -> Any:
        return _only(name, change, process, _only("optimizer", _NoJournal, process, bus))

    return Sabotage(wrap=wrap)


def _early_cursor(name: str) -> Sabotage:
    cursor = [0]
    return _wrapping(name, lambda bus: _EarlyCursor(bus, cursor))


# What each defect is, and how to put it into one run.
SABOTAGES: dict[str, Callable[[], Sabotage]] = {
    "ingest acks before the commit": lambda: _wrapping(
        "ingest", lambda bus: _AckFirst(bus, keyexprs.AGENT_KEYFRAMES)
    ),
    "ingest acks before the sync": lambda: Sabotage(lying_disks=("ingest",)),
    "robot forgets a keyframe before the ack": lambda: _wrapping(
        "robot", lambda bus: _HopeForTheBest(bus, keyexprs.AGENT_KEYFRAMES)
    ),
    "robot's send returns before the sync": lambda: Sabotage(
        lying_disks=("robot0", "robot1", "robot2")
    ),
    "optimizer acks a loop before the commit": lambda: _without_journal(
        "optimizer", lambda bus: _AckFirst(bus, keyexprs.LOOP)
    ),
    "worker calls a job done before its loop is stored": lambda: _without_journal(
        "worker", lambda bus: _HopeForTheBest(bus, keyexprs.LOOP)
    ),
    "optimizer stores its cursor when a page comes": lambda: _early_cursor("optimizer"),
    "place recognition stores its cursor when a page comes": lambda: _early_cursor(
        "place_recognition"
    ),
    "ingest does not know an upload again": lambda: Sabotage(runs={"ingest": _run_without_memory}),
    "optimizer does not ask for the loops it lost": lambda: _wrapping("optimizer", _NoJournal),
    "optimizer does not know a loop again": lambda: _wrapping("optimizer", _EveryLoopIsNew),
}
