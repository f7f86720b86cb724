"""Bulk reads of the keyframe log, beside the commits: pages, single keyframes and cameras."""

from __future__ import annotations

import logging
import sqlite3
from collections import deque
from collections.abc import Callable
from pathlib import Path

from covinz import codec, keyexprs
from covinz.bus import Bus, Query
from covinz.durable import open_reader
from covinz.machine import THIS_MACHINE, Machine
from covinz.types import KeyframeId, LogRange, LogView
from services.ingest.history import chain_at, digest_of

logger = logging.getLogger(__name__)

# SQL per view, so that the column is never text from outside.
_RANGE = {
    LogView.POSE: "SELECT log_index, pose FROM entry WHERE log_index >= ? ORDER BY log_index",
    LogView.FULL: "SELECT log_index, digest, pose, payload FROM entry WHERE log_index >= ?"
    " ORDER BY log_index",
}
# Larger numbers do not fit in a column of SQLite; no entry has them.
_MAX_INTEGER = 2**63 - 1
# Questions that wait for their turn; later ones go unanswered and are asked again.
_MAX_WAITING = 64


class OtherHistory(Exception):
    """Who asks has followed a log with this identity and other entries, or more of them."""


class LogReader:
    """The reading side of the log, for one thread; never delays a commit.

    Args:
        path: The file of an open `KeyframeLog`.
        page_bytes: Size that a page does not exceed, unless its first entry alone does.

    Raises:
        sqlite3.Error: From every method, if the file cannot be read.
    """

    def __init__(self, path: Path, page_bytes: int) -> None:
        self._page_bytes = page_bytes
        self._path = path
        self._damaged: set[int] = set()
        self._db = open_reader(path)

    def page(self, asked: LogRange) -> bytes:
        """The LogPage message that answers `asked`; empty only at the head.

        Raises:
            OtherHistory: If the asker has followed another history under the log's identity.
        """
        db, start = self._db, min(asked.start, _MAX_INTEGER)
        db.execute("BEGIN")  # everything of one moment
        try:
            (log_id,) = db.execute("SELECT log_id FROM identity").fetchone()
            (head,) = db.execute("SELECT COALESCE(MAX(log_index) + 1, 0) FROM entry").fetchone()
            known = chain_at(db, start)
            if asked.log_id == log_id and (known is None or asked.chain not in ("", known.hex())):
                raise OtherHistory(log_id)
            entries = self._entries(start, asked.view)
            chain = chain_at(db, start + len(entries))
        finally:
            db.execute("ROLLBACK")
        return codec.encode_log_page(log_id, head, entries, chain.hex() if chain else "")

    def keyframe(self, keyframe_id: KeyframeId) -> bytes | None:
        """The Keyframe message as it was uploaded; None when the log has none.

        Without features when they were dropped.
        """
        if keyframe_id.seq > _MAX_INTEGER:
            return None
        row = self._db.execute(
            "SELECT log_index, digest, pose, payload FROM entry"
            " WHERE agent = ? AND session = ? AND is_gap = 0 AND first_seq = ?",
            (keyframe_id.agent, keyframe_id.session, keyframe_id.seq),
        ).fetchone()
        return None if row is None else self._checked(*row)

    def camera(self, camera_hash: str) -> bytes | None:
        """The Camera message as it was registered; None when there is none."""
        row = self._db.execute(
            "SELECT payload FROM camera WHERE hash = ?", (camera_hash,)
        ).fetchone()
        return None if row is None else bytes(row[0])

    def close(self) -> None:
        """Close the connection."""
        self._db.close()

    def _entries(self, start: int, view: LogView) -> list[tuple[int, bytes]]:
        """As many entries from `start` on as fit into a page; at least one, if there is one."""
        entries: list[tuple[int, bytes]] = []
        size = 0
        for log_index, *columns in self._db.execute(_RANGE[view], (start,)):
            payload = columns[0] if view is LogView.POSE else self._checked(log_index, *columns)
            size += len(payload)
            if entries and size > self._page_bytes:
                break
            entries.append((log_index, payload))
        return entries

    def _checked(self, log_index: int, digest: bytes, pose: bytes, payload: bytes) -> bytes:
        """The payload, if it is what was uploaded; else what is left: the pose."""
        if digest_of(payload) == digest:
            return payload
        if payload and log_index not in self._damaged:
            self._damaged.add(log_index)
            logger.error(
                "%s is damaged: the features of entry %d are lost. Restore a backup "
                "(covinz restore)",
                self._path,
                log_index,
            )
        return pose


class LogReads:
    """Answers questions about the log, from a thread of its own.

    An unknown keyframe or camera is answered by an empty message; a question that makes no sense,
    or that comes when too many wait, gets no answer at all.

    Args:
        bus: Where they are asked.
        reader: What they are answered from.
        on_other_history: Called with the log's identity when somebody has followed another log
            under it; who asked is not answered, and asks again.
        machine: For the thread.
    """

    def __init__(
        self,
        bus: Bus,
        reader: LogReader,
        on_other_history: Callable[[str], object],
        machine: Machine = THIS_MACHINE,
    ) -> None:
        self._reader = reader
        self._on_other_history = on_other_history
        self._changed = machine.condition()  # guards what follows
        self._waiting: deque[Query] = deque()
        self._closing = False
        self._thread = machine.thread(self._run, "log-reads")
        self._thread.start()
        keys = (keyexprs.LOG_RANGE, keyexprs.KEYFRAMES, keyexprs.CAMERAS)
        self._declared = [bus.answer(key, self._on_query) for key in keys]

    def close(self) -> None:
        """Answer what waits, then stop."""
        for declared in self._declared:
            declared.close()
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def _on_query(self, query: Query) -> None:
        with self._changed:
            if len(self._waiting) < _MAX_WAITING:
                self._waiting.append(query)
                self._changed.notify_all()
                return
        query.drop()

    def _next(self) -> Query | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closing or self._waiting)
            return self._waiting.popleft() if self._waiting else None

    def _run(self) -> None:
        while (query := self._next()) is not None:
            try:
                query.reply(self._answer(query) or b"")
            except OtherHistory as error:
                self._on_other_history(str(error))
                query.drop()
            except (ValueError, sqlite3.Error) as error:
                logger.warning("no answer to %s: %s", query.key, error)
                query.drop()

    def _answer(self, query: Query) -> bytes | None:
        if query.key == keyexprs.LOG_RANGE:
            return self._reader.page(codec.decode(query.payload, LogRange))
        if query.key.startswith("covinz/camera/"):
            return self._reader.camera(keyexprs.camera_of(query.key))
        return self._reader.keyframe(keyexprs.keyframe_of(query.key))
