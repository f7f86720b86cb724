"""Ingest: uploads in, the keyframe log out. One thread owns the log; the bus only enqueues."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from covinz import codec, keyexprs
from covinz.bus import Bus
from covinz.config import IngestConfig
from covinz.logs import about
from covinz.machine import Machine
from covinz.service import Context, Inbox, StatusRequest
from covinz.types import (
    Duplicate,
    Gap,
    LogHead,
    NeedCamera,
    Rejected,
    RetryAfter,
    Status,
    Stored,
    UploadReply,
)
from services.ingest.admission import (
    AdmittedCamera,
    AdmittedUpload,
    Code,
    admit_camera,
    admit_upload,
    rejected,
)
from services.ingest.agent_book import AgentBook
from services.ingest.intake import Intake, Upload
from services.ingest.keyframe_log import KeyframeLog, LogUnavailable
from services.ingest.log_reader import LogReader, LogReads
from services.ingest.retention import Retention
from services.ingest.trouble import StoreTrouble

logger = logging.getLogger(__name__)

# Agents and codes whose first rejection is logged as a warning.
_MAX_COMPLAINTS = 1000


@dataclass(frozen=True, slots=True)
class OtherHistoryKnown:
    """Somebody has followed a log with this identity, and it was not this one."""

    log_id: str


class OpenLog(Protocol):
    """Opens the keyframe log; `KeyframeLog`."""

    def __call__(self, path: Path, *, machine: Machine) -> KeyframeLog:
        """The log in a file; raises DurableFileError."""


def run(context: Context, open_log: OpenLog = KeyframeLog) -> None:
    """Serve uploads until `context.inbox` raises Stopped.

    Args:
        context: What the process is given.
        open_log: Opens the log.

    Raises:
        DurableFileError: If the log's file cannot be used.
    """
    config = context.config.ingest
    path = context.data_dir / "ingest.sqlite"
    intake = Intake(context.inbox, config)
    with ExitStack() as stack:
        log = stack.enter_context(closing(open_log(path, machine=context.machine)))
        reader = stack.enter_context(closing(LogReader(path, config.page_bytes)))
        reads = LogReads(context.bus, reader, partial(_other, context.inbox), context.machine)
        stack.enter_context(closing(reads))
        min_features = context.config.place_recognition.min_features
        book = AgentBook(context.instance, min_features, context.machine)
        ingest = Ingest(log, intake, context.bus, config, context.instance, book)
        clock_s = context.machine.monotonic_s
        retention = Retention(log.retained, lambda: log.head, config, clock_s)
        for key, callback in (
            (keyexprs.AGENT_KEYFRAMES, context.telemetry.timed("ingest_ack", intake.on_keyframe)),
            (keyexprs.AGENT_CAMERAS, intake.on_camera),
            (keyexprs.AGENT_STATUSES, book.answer),
        ):
            stack.enter_context(closing(context.bus.answer(key, callback)))
        ingest.announce()
        while True:
            first = context.inbox.take(retention.patience_s())
            ingest.handle([first, *context.inbox.drain(config.max_batch - 1)] if first else [])
            retention.check_now()
            retention.step()


def _other(inbox: Inbox, log_id: str) -> None:
    inbox.put_always(OtherHistoryKnown(log_id))


class Ingest:
    """Admits uploads, commits them in groups and answers only what is durable."""

    def __init__(
        self,
        log: KeyframeLog,
        intake: Intake,
        bus: Bus,
        config: IngestConfig,
        instance: str,
        book: AgentBook,
    ) -> None:
        self._log = log
        self._intake = intake
        self._bus = bus
        self._config = config
        self._instance = instance
        self._book = book
        self._trouble = StoreTrouble(config)
        self._complained: set[tuple[str, str]] = set()
        self._counters: Counter[str] = Counter()
        for agent, totals in log.totals().items():
            self._counters[f"keyframes.{agent}"] = totals.keyframes
            self._counters[f"bytes.{agent}"] = totals.payload_bytes
            self._counters[f"gaps.{agent}"] = totals.gaps
            self._counters[f"dropped_keyframes.{agent}"] = totals.dropped_keyframes
        self._cameras_of: Counter[str] = Counter(log.camera_counts())

    def handle(self, events: Sequence[object]) -> None:
        """Store all uploads among `events` with one commit, then answer everything."""
        self._store([event for event in events if isinstance(event, Upload)])
        for event in events:
            match event:
                case StatusRequest():
                    event.answer(self.status())
                case OtherHistoryKnown(log_id):
                    self._begin_history(log_id)

    def announce(self) -> None:
        """Wake the log's readers."""
        self._bus.put(keyexprs.LOG_HEAD, codec.encode(LogHead(self._log.log_id, self._log.head)))

    def status(self) -> Status:
        """Cursor is the head of the log; counters since the log began, refusals since the start."""
        counters = self._counters + self._intake.refused + self._trouble.counters
        counters["entries_without_features"] = self._log.retained.features_from
        counters["log_bytes"] = self._log.retained.used_bytes
        for name in ("keyframes", "bytes", "gaps", "dropped_keyframes"):
            counters[name] = sum(n for key, n in counters.items() if key.startswith(f"{name}."))
        return Status(
            service="ingest",
            instance=self._instance,
            log_id=self._log.log_id,
            cursor=self._log.head,
            pending=self._intake.waiting,
            leased=0,
            dirty=False,
            counters={name: float(count) for name, count in sorted(counters.items())},
        )

    def _begin_history(self, known: str) -> None:
        if known != self._log.log_id:  # several have said so
            return
        try:
            log_id = self._log.begin_history()
        except LogUnavailable as error:
            logger.error("the log cannot be given another identity: %s", error)
            return
        logger.error(
            "this is not the log %s that others have followed: its file was replaced by an older "
            "or another one. It is log %s from now on, and whoever follows it starts over",
            known,
            log_id,
        )
        self.announce()

    def _store(self, uploads: Sequence[Upload]) -> None:
        admitted: list[tuple[Upload, AdmittedUpload | AdmittedCamera]] = []
        for upload in uploads:
            verdict = self._admit(upload)
            if isinstance(verdict, AdmittedUpload | AdmittedCamera):
                admitted.append((upload, verdict))
            else:
                self._answer(upload, verdict)
        if not admitted:
            return
        head = self._log.head
        for (upload, record), answer in zip(admitted, self._commit(admitted), strict=True):
            if isinstance(answer, Stored):
                self._count(upload.agent, record)
            self._answer(upload, answer)
        if self._log.head != head:
            self.announce()

    def _admit(
        self, upload: Upload
    ) -> AdmittedUpload | AdmittedCamera | NeedCamera | Rejected | RetryAfter:
        try:
            if not upload.is_camera:
                return admit_upload(upload.agent, upload.payload, self._log.cameras, self._config)
            verdict = admit_camera(upload.agent, upload.payload)
        except Exception:  # a bug of ours must not let one agent's upload stop the others
            logger.exception(
                "cannot judge an upload of %s", upload.agent, extra=about(agent=upload.agent)
            )
            return RetryAfter(self._config.retry_after_s, "internal error")
        if isinstance(verdict, AdmittedCamera) and self._is_one_too_many(verdict):
            limit = self._config.max_cameras_per_agent
            return rejected(Code.TOO_MANY_CAMERAS, f"{upload.agent} has {limit} already")
        return verdict

    def _is_one_too_many(self, record: AdmittedCamera) -> bool:
        known = record.camera.hash in self._log.cameras
        return not known and self._cameras_of[record.agent] >= self._config.max_cameras_per_agent

    def _commit(
        self, admitted: Sequence[tuple[Upload, AdmittedUpload | AdmittedCamera]]
    ) -> Sequence[UploadReply]:
        if (refusal := self._trouble.refusal()) is not None:
            return [refusal] * len(admitted)
        try:
            answers = self._log.append([record for _, record in admitted])
            self._trouble.end()
            return answers
        except LogUnavailable as error:
            return [self._trouble.begin(error, len(admitted))] * len(admitted)

    def _count(self, agent: str, record: AdmittedUpload | AdmittedCamera) -> None:
        if isinstance(record, AdmittedCamera):
            self._cameras_of[agent] += 1
            self._book.registered(agent, record.camera)
            return
        self._counters[f"bytes.{agent}"] += len(record.payload)
        if isinstance(record.item, Gap):
            dropped = record.item.last_seq - record.item.first_seq + 1
            self._counters[f"gaps.{agent}"] += 1
            self._counters[f"dropped_keyframes.{agent}"] += dropped
        else:
            self._counters[f"keyframes.{agent}"] += 1
            self._book.stored(record.item)

    def _answer(self, upload: Upload, answer: UploadReply) -> None:
        match answer:
            case Duplicate() if not upload.is_camera:
                self._counters["duplicates"] += 1
            case NeedCamera():
                self._counters["need_camera"] += 1
            case RetryAfter():
                self._counters["retry_after"] += 1
            case Rejected(code, reason):
                self._counters[f"rejected.{code}"] += 1
                self._book.refused(upload.agent, code)
                self._log_rejection(upload.agent, code, reason)
        self._intake.done(upload)
        upload.query.reply(codec.encode(answer))

    def _log_rejection(self, agent: str, code: str, reason: str) -> None:
        """Say it once per agent and code: a flood of bad uploads must not flood the logs."""
        is_new = (agent, code) not in self._complained and len(self._complained) < _MAX_COMPLAINTS
        level = logging.DEBUG
        if is_new:
            self._complained.add((agent, code))
            level = logging.WARNING
        logger.log(
            level,
            "rejected an upload of %s: %s: %s",
            agent,
            code,
            reason,
            extra=about(agent=agent),
        )
