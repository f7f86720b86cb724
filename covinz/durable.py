"""SQLite files that survive a crash: durable commits, one owner, a kind and a version."""

from __future__ import annotations

import fcntl
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote


class DurableFileError(RuntimeError):
    """A file that cannot be used; the message says which, why and what to do."""


@dataclass(frozen=True, slots=True)
class FileKind:
    """What is in a file, written into its header.

    Attributes:
        name: For messages, e.g. ``keyframe log``.
        application_id: Four characters that tell our files from others.
        version: Of the schema; a file of another version is refused.
        schema: SQL that makes an empty file of this kind.
    """

    name: str
    application_id: bytes
    version: int
    schema: str


class DurableFile:
    """An open file: `db` commits durably (WAL, ``synchronous=FULL``), nobody else may open it.

    Args:
        path: Made, with its folder, when it is not there.
        kind: Expected content.
        busy_timeout_s: How long a statement waits for a lock that another connection holds.

    Raises:
        DurableFileError: If another process owns the file, or it is damaged, of another kind or
            of another version.
    """

    def __init__(self, path: Path, kind: FileKind, busy_timeout_s: float = 5.0) -> None:
        self.path = path
        self._lock = claim(path)
        try:
            self.db = _connect(f"file:{quote(str(path))}", busy_timeout_s)
            try:
                _prepare(self.db, path, kind)
            except BaseException:
                self.db.close()
                raise
        except BaseException as error:
            os.close(self._lock)
            if isinstance(error, sqlite3.Error):
                raise DurableFileError(f"cannot use {path} as a {kind.name}: {error}") from error
            raise

    @contextmanager
    def transaction(self, durable: bool = True) -> Iterator[sqlite3.Connection]:
        """All or nothing: durable when the block ends, undone when it raises.

        With `durable` false a power cut may undo it too, but only together with everything
        after it; that saves waiting for the disk.
        """
        self.db.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")
        self.db.execute("BEGIN IMMEDIATE")
        try:
            yield self.db
            self.db.execute("COMMIT")
        except BaseException:
            if self.db.in_transaction:
                self.db.execute("ROLLBACK")
            raise

    def close(self) -> None:
        """Close the file and let others open it; may be called again."""
        self.db.close()
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def open_reader(path: Path, busy_timeout_s: float = 5.0) -> sqlite3.Connection:
    """A second, read-only connection; never waits for the writer, nor the writer for it.

    Raises:
        sqlite3.Error: If there is no such file.
    """
    return _connect(f"file:{quote(str(path))}?mode=ro", busy_timeout_s)


def _connect(uri: str, busy_timeout_s: float) -> sqlite3.Connection:
    # Transactions are explicit; threads are kept apart by whoever owns the connection.
    return sqlite3.connect(
        uri, uri=True, timeout=busy_timeout_s, isolation_level=None, check_same_thread=False
    )


def claim(path: Path) -> int:
    """Hold ``<path>.lock`` as long as the process lives, even if it is killed.

    Returns:
        A file descriptor; closing it gives the lock back.

    Raises:
        DurableFileError: If another process holds it, or it cannot be made.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise DurableFileError(f"cannot open {path}: {error}") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise DurableFileError(f"{path} is in use by another process") from error
    return descriptor


def _prepare(db: sqlite3.Connection, path: Path, kind: FileKind) -> None:
    wanted = int.from_bytes(kind.application_id, "big")
    (application_id,) = db.execute("PRAGMA application_id").fetchone()
    (version,) = db.execute("PRAGMA user_version").fetchone()
    (tables,) = db.execute("SELECT COUNT(*) FROM sqlite_schema").fetchone()
    is_new = (application_id, version, tables) == (0, 0, 0)
    if not is_new and application_id != wanted:
        raise DurableFileError(f"{path} is not a {kind.name}")
    if not is_new and version != kind.version:
        raise DurableFileError(
            f"{path}: {kind.name} of format {version}, this program reads format {kind.version}"
        )
    (mode,) = db.execute("PRAGMA journal_mode = WAL").fetchone()
    if mode != "wal":
        raise DurableFileError(f"{path}: the file system has no shared memory maps for WAL")
    if is_new:
        db.executescript(
            f"BEGIN IMMEDIATE;\n{kind.schema}\n"
            f"PRAGMA application_id = {wanted};\nPRAGMA user_version = {kind.version};\nCOMMIT;"
        )
