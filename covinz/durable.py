"""SQLite files that survive a crash: durable commits, one owner, a kind and a version."""

from __future__ import annotations

import fcntl
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from covinz import damage

# In the lock of a file that has been made: if it is empty now, it has lost what it held.
_MADE = b"made\n"


class DurableFileError(RuntimeError):
    """A file that cannot be used; the message says which, why and what to do."""


class DamagedFile(DurableFileError):
    """A file of ours whose content is broken; nothing in it was changed."""


@dataclass(frozen=True, slots=True)
class FileKind:
    """What is in a file, written into its header.

    Attributes:
        name: For messages, e.g. ``keyframe log``.
        application_id: Four characters that tell our files from others.
        version: Of the schema, from 1 on; a file of a newer version is refused.
        schema: SQL that makes an empty file of this kind.
        upgrades: For each older version that can be read, from the oldest on, what turns a file of
            it into one of the next version.
    """

    name: str
    application_id: bytes
    version: int
    schema: str
    upgrades: tuple[Callable[[sqlite3.Connection], None], ...] = ()


class DurableFile:
    """An open file: `db` commits durably (WAL, ``synchronous=FULL``), nobody else may open it.

    Args:
        path: Made, with its folder, when it is not there.
        kind: Expected content.
        busy_timeout_s: How long a statement waits for a lock that another connection holds.

    Raises:
        DamagedFile: If it is damaged.
        DurableFileError: If another process owns the file, or it is of another kind or of a
            version that this program does not read, or cannot be written.
    """

    def __init__(self, path: Path, kind: FileKind, busy_timeout_s: float = 5.0) -> None:
        self.path = path
        self._lock = claim(path)
        try:
            # Before SQLite looks at it: beside an empty file it would delete the -wal file.
            if _is_empty(path) and os.pread(self._lock, len(_MADE), 0) == _MADE:
                raise DamagedFile(_damaged(path, kind, "the file is empty"))
            version = _version(path, kind, busy_timeout_s)
            self.db = _connect(f"file:{quote(str(path))}", busy_timeout_s)
            try:
                _prepare(self.db, path, kind, version)
            except BaseException:
                self.db.close()
                raise
            os.pwrite(self._lock, _MADE, 0)
        except BaseException as error:
            os.close(self._lock)
            if isinstance(error, sqlite3.Error):
                if damage.Trouble.of(error) is damage.Trouble.DAMAGED:
                    raise DamagedFile(_damaged(path, kind, str(error))) from error
                raise DurableFileError(f"cannot use {path} as a {kind.name}: {error}") from error
            raise

    @contextmanager
    def transaction(self, durable: bool = True) -> Iterator[sqlite3.Connection]:
        """All or nothing: durable when the block ends, undone when it raises.

        With `durable` false a power cut may undo it too, but only together with everything
        after it; that saves waiting for the disk.
        """
        if self.db.in_transaction:  # the last one could not even be undone
            self.db.execute("ROLLBACK")
        self.db.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")
        self.db.execute("BEGIN IMMEDIATE")
        try:
            yield self.db
            self.db.execute("COMMIT")
        except BaseException:
            if self.db.in_transaction:
                with suppress(sqlite3.Error):  # what went wrong first is what counts
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


def _is_empty(path: Path) -> bool:
    try:
        return path.stat().st_size == 0
    except FileNotFoundError:
        return False


def _damaged(path: Path, kind: FileKind, why: str) -> str:
    return (
        f"cannot use {path} as a {kind.name}: {why}. Nothing in it was changed: restore a backup "
        "(covinz restore), or move it away to begin anew"
    )


def _version(path: Path, kind: FileKind, busy_timeout_s: float) -> int:
    """The version of an existing file of this kind; 0 when there is nothing in it yet.

    Nothing is written: a connection that may write would put what is in the -wal file into a
    file that is damaged.
    """
    if not path.exists() or _is_empty(path):
        return 0
    with closing(open_reader(path, busy_timeout_s)) as db:
        (application_id,) = db.execute("PRAGMA application_id").fetchone()
        (version,) = db.execute("PRAGMA user_version").fetchone()
        (tables,) = db.execute("SELECT COUNT(*) FROM sqlite_schema").fetchone()
        if (application_id, version, tables) == (0, 0, 0):
            return 0
        if application_id != int.from_bytes(kind.application_id, "big"):
            raise DurableFileError(
                f"{path} is not a {kind.name}, but a database of another program: move it away"
            )
        if not kind.version - len(kind.upgrades) <= version <= kind.version:
            raise DurableFileError(
                f"{path}: {kind.name} of format {version}, this program reads format "
                f"{kind.version}: use the {'newer' if version > kind.version else 'older'} one "
                f"that wrote it, or restore a backup of format {kind.version}"
            )
        if (found := damage.examine(db, path)) is not None:
            raise DamagedFile(_damaged(path, kind, found))
        return int(version)


def _prepare(db: sqlite3.Connection, path: Path, kind: FileKind, version: int) -> None:
    if not version:
        # Lets `PRAGMA incremental_vacuum` give space back; only possible while there is no table.
        db.execute("PRAGMA auto_vacuum = INCREMENTAL")
    (mode,) = db.execute("PRAGMA journal_mode = WAL").fetchone()
    if mode != "wal":
        raise DurableFileError(f"{path}: the file system has no shared memory maps for WAL")
    if not version:
        db.executescript(
            f"BEGIN IMMEDIATE;\n{kind.schema}\n"
            f"PRAGMA application_id = {int.from_bytes(kind.application_id, 'big')};\n"
            f"PRAGMA user_version = {kind.version};\nCOMMIT;"
        )
    elif version < kind.version:
        _upgrade(db, kind, version)


def _upgrade(db: sqlite3.Connection, kind: FileKind, version: int) -> None:
    """Bring an older file to the version of this program, in one transaction."""
    oldest = kind.version - len(kind.upgrades)
    db.execute("BEGIN IMMEDIATE")
    for step in kind.upgrades[version - oldest :]:
        step(db)
    db.execute(f"PRAGMA user_version = {kind.version}")
    db.execute("COMMIT")
