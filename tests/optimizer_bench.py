"""An optimizer whose log, clock and worker are in the hands of a test."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from queue import SimpleQueue

from covinz import codec, keyexprs
from covinz.config import OptimizerConfig
from covinz.log_follower import LogReset
from covinz.memory_bus import Hub
from covinz.service import StatusRequest
from covinz.types import (
    Correction,
    Gap,
    Keyframe,
    LogEntry,
    LogPage,
    LoopClosure,
    MapList,
    MapSnapshot,
    Status,
    UploadReply,
)
from services.optimizer.components import Component
from services.optimizer.doors import Asked, LoopBrought
from services.optimizer.loop_store import LoopStore
from services.optimizer.service import Optimizer
from services.optimizer.worker import run_job
from tests.fleets import session

CONFIG = OptimizerConfig(settle_s=1.0)
LOG = "01JD0000000000000000000000"


class Question:
    """A query whose answers can be looked at."""

    def __init__(self, key: str, payload: bytes = b"") -> None:
        self.key, self.payload = key, payload
        self.answers: list[bytes] = []
        self.dropped = False

    def reply(self, payload: bytes) -> None:
        self.answers.append(payload)

    def drop(self) -> None:
        self.dropped = True


class Bench:
    """Steps of the optimizer's thread: a fake clock, jobs run by hand, a real store and bus."""

    def __init__(self, folder: Path, has_journal: bool = False) -> None:
        self.folder = folder
        self.has_journal = has_journal
        self.looks: list[str] = []
        self.now_s = 100.0
        hub = Hub()
        self._bus, self._listener = hub.join(), hub.join()
        self._published: SimpleQueue[bytes] = SimpleQueue()
        self._listener.subscribe(
            keyexprs.AGENT_CORRECTIONS, lambda _, payload: self._published.put(payload)
        )
        self.log_index = 0
        self.start()

    def start(self) -> None:
        self.jobs: list[tuple[tuple[Component, ...], int]] = []
        self.store = LoopStore(self.folder / "optimizer.sqlite")
        self.optimizer = Optimizer(
            self.store,
            self._bus,
            CONFIG,
            lambda components, epoch: self.jobs.append((components, epoch)),
            "optimizer",
            clock_s=lambda: self.now_s,
            now_ns=lambda: 5,
            look_for_loops=self.looks.append if self.has_journal else None,
        )

    def set_writable(self, writable: bool) -> None:
        """Whether the store's disk takes writes."""
        self.store._file.db.execute(f"PRAGMA query_only = {not writable}")

    def restart(self) -> None:
        self.store.close()
        self.start()

    def close(self) -> None:
        self.store.close()
        self._bus.close()
        self._listener.close()

    def begin(self, log_id: str = LOG) -> None:
        self.log_index = 0
        self.optimizer.handle([LogReset(log_id)])

    def read(self, items: Sequence[Keyframe | Gap], log_id: str = LOG, to_come: int = 0) -> None:
        entries = tuple(LogEntry(self.log_index + n, item) for n, item in enumerate(items))
        self.log_index += len(items)
        self.optimizer.handle([LogPage(log_id, self.log_index + to_come, entries)])

    def bring(self, loop: LoopClosure | bytes) -> UploadReply:
        payload = loop if isinstance(loop, bytes) else codec.encode(loop)
        question = Question(keyexprs.LOOP, payload)
        self.optimizer.handle([LoopBrought(question)])
        (answer,) = question.answers
        return codec.decode_upload_reply(answer)

    def run(self) -> int:
        """Run jobs until there is none; returns how many."""
        count = 0
        while self.jobs:
            self.finish(self.jobs.pop(0))
            count += 1
        return count

    def finish(self, job: tuple[tuple[Component, ...], int]) -> None:
        self.optimizer.handle([run_job(*job, CONFIG)])

    def settle(self) -> None:
        self.now_s += CONFIG.settle_s
        self.optimizer.handle([])

    def status(self) -> Status:
        question = Question(keyexprs.service_status("optimizer", "optimizer"))
        self.optimizer.handle([StatusRequest(question)])
        return codec.decode(question.answers[0], Status)

    def ask(self, key: str) -> bytes | None:
        question = Question(key)
        self.optimizer.handle([Asked(question)])
        assert question.dropped is not bool(question.answers)
        return question.answers[0] if question.answers else None

    def maps(self) -> MapList:
        return codec.decode(self.ask(keyexprs.MAP_LIST) or b"", MapList)

    def snapshot(self, number: int = 0) -> MapSnapshot:
        return codec.decode(self.ask(keyexprs.map_snapshot(session(number))) or b"", MapSnapshot)

    def heard(self, count: int) -> list[Correction]:
        return [codec.decode(self._published.get(timeout=10), Correction) for _ in range(count)]

    def heard_nothing_more(self) -> bool:
        # The bus keeps its order: behind a last word of ours there is nothing.
        self._bus.put(keyexprs.agent_correction("last"), b"word")
        return self._published.get(timeout=10) == b"word"
