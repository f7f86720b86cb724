"""What is wrong with a SQLite file that fails: full disk or broken content; and what is done then.

A file that can be rebuilt is set aside, never overwritten, and made anew. One that cannot is for a
person to restore.
"""

from __future__ import annotations

import enum
import logging
import os
import sqlite3
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

logger = logging.getLogger(__name__)

# Larger files are not read through at every start: that would keep robots waiting. What is broken
# in them is noticed when it is read, and by `covinz backup`. [bytes; measured: 1 GB/s]
EXAMINED_BYTES = 256 * 1024 * 1024
# All parts of a file in WAL mode.
PARTS = ("", "-wal", "-shm")
F = TypeVar("F")


class Trouble(enum.StrEnum):
    """Why a file cannot be written; the name under which a status counts it."""

    DISK_FULL = "disk_full"  # passes when there is room
    DAMAGED = "damaged"  # trying again is pointless
    OTHER = "other"  # the disk or its file system; perhaps it passes

    @classmethod
    def of(cls, error: sqlite3.Error) -> Trouble:
        """What an error of SQLite means."""
        # Extended codes have the primary one in their lowest byte; the module's errors have none.
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
            return cls.DAMAGED
        return cls.DISK_FULL if code == sqlite3.SQLITE_FULL else cls.OTHER

    @property
    def words(self) -> str:
        """For a person at the other end of the bus."""
        return {
            Trouble.DISK_FULL: "the server's disk is full",
            Trouble.DAMAGED: "a file of the server is damaged",
            Trouble.OTHER: "the server cannot write to its disk",
        }[self]


class CommitFailed(RuntimeError):
    """A commit failed and the file is as it was before.

    Attributes:
        trouble: Why.
    """

    def __init__(self, path: Path, error: sqlite3.Error) -> None:
        super().__init__(f"{path}: {error}")
        self.trouble = Trouble.of(error)


def examine(db: sqlite3.Connection, path: Path, limit_bytes: int = EXAMINED_BYTES) -> str | None:
    """What is broken in the structure of a file of at most `limit_bytes`; None when nothing is.

    Raises:
        sqlite3.Error: If it is so broken that it cannot be examined.
    """
    if path.stat().st_size > limit_bytes:
        return None
    (found,) = db.execute("PRAGMA quick_check(1)").fetchone()
    return None if found == "ok" else " ".join(str(found).split())


def set_aside(path: Path, why: str, now: datetime | None = None) -> Path:
    """Give a file another name, with a time stamp; returns it.

    Raises:
        OSError: If it cannot be renamed.
    """
    stamp = (now or datetime.now(UTC)).strftime("%Y%m%dT%H%M%S.%fZ")
    kept = path.with_name(f"{path.name}.{why}-{stamp}")
    for part in PARTS:
        if os.path.lexists(f"{path}{part}"):
            os.rename(f"{path}{part}", f"{kept}{part}")
    return kept


def rebuildable(path: Path, open_file: Callable[[], F], damaged: type[Exception]) -> F:
    """Open a file that can be rebuilt: if it is damaged it is set aside and made anew.

    Args:
        path: The file.
        open_file: Opens it, or makes it when it is not there.
        damaged: What `open_file` raises when it is damaged.
    """
    try:
        return open_file()
    except damaged as error:
        kept = set_aside(path, "damaged")
        logger.error("%s", error)
        logger.error("%s was kept as %s; what it held is computed anew", path.name, kept)
        return open_file()
