"""Copies of a server's files: taken while it runs, checked, and brought back.

Consumers' files are copied before the log, so what they have seen is in the copy of the log too:
a restored server goes on where the copy was made. Keyframes acknowledged later are not in it.

Source: https://www.sqlite.org/backup.html; decision 0029.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sqlite3
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from covinz import damage, durable

MANIFEST = "backup.json"
# Of the manifest.
FORMAT = 1
# File of each service, in the order in which they are copied: the kind in its header, and the
# newest version that this program reads. (tests/contract/test_backup.py compares them.)
KINDS: Mapping[str, tuple[bytes, int]] = {
    "place_recognition": (b"cvzJ", 2),
    "optimizer": (b"cvzO", 2),
    "ingest": (b"cvzL", 2),
}
_CHUNK = 1 << 20


class BackupError(RuntimeError):
    """A backup that cannot be made or brought back; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Copied:
    """One file of a backup.

    Attributes:
        file: Its name.
        version: Format of its content.
        size_bytes: Its size.
        sha256: Of its bytes.
    """

    file: str
    version: int
    size_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a backup holds.

    Attributes:
        covinz: Version of the program that made it.
        created: Time, UTC, ISO 8601.
        log_id: The keyframe log.
        head: Number of entries in it.
        files: By service.
    """

    covinz: str
    created: str
    log_id: str
    head: int
    files: Mapping[str, Copied]


def file_of(data: Path, service: str) -> Path:
    """The file of a service: in a folder of its own where there is one, as with Compose."""
    folder = data / service
    return (folder if folder.is_dir() else data) / f"{service}.sqlite"


def back_up(data: Path, folder: Path) -> Manifest:
    """Copy the files of a server, which may run, into a new folder.

    The folder appears when everything in it is complete and on the disk.

    Raises:
        BackupError: If there is no log, the folder is there already, or a file is damaged.
        OSError: If it cannot be written.
    """
    if not file_of(data, "ingest").is_file():
        raise BackupError(f"there is no keyframe log in {data}")
    if folder.exists():
        raise BackupError(f"{folder} is there already: name a new folder")
    partial = folder.with_name(f"{folder.name}.partial-{os.getpid()}")
    partial.mkdir(parents=True)
    try:
        manifest = _fill(partial, data)
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial)
        raise
    _sync(folder.parent)
    return manifest


def _fill(folder: Path, data: Path) -> Manifest:
    created = datetime.now(UTC).isoformat(timespec="seconds")
    files = {
        service: _copy(file_of(data, service), folder, service)
        for service in KINDS
        if file_of(data, service).is_file()
    }
    with closing(durable.open_reader(folder / files["ingest"].file)) as log:
        (log_id,) = log.execute("SELECT log_id FROM identity").fetchone()
        (head,) = log.execute("SELECT COALESCE(MAX(log_index) + 1, 0) FROM entry").fetchone()
    _remove_parts(folder)
    manifest = Manifest(metadata.version("covinz"), created, log_id, head, files)
    text = json.dumps({"format": FORMAT, **asdict(manifest)}, indent=2)
    (folder / MANIFEST).write_text(text + "\n")
    _sync(folder / MANIFEST)
    _sync(folder)
    return manifest


def restore(folder: Path, data: Path, force: bool = False) -> tuple[Manifest, list[Path]]:
    """Put a backup in the place of a stopped server's files.

    Args:
        folder: The backup.
        data: Where the server keeps its files.
        force: Files that are there are set aside under other names; without, nothing is done then.

    Returns:
        What was brought back, and the files that were set aside.

    Raises:
        BackupError: If the backup is not complete, damaged, or of a newer program; if there are
            files and `force` is not set. Nothing was changed then.
        DurableFileError: If the server runs.
        OSError: If it cannot be written.
    """
    manifest = read_manifest(folder)
    verify(folder, manifest)
    with ExitStack() as stack:
        for path in (data / "server", *(file_of(data, service) for service in KINDS)):
            stack.enter_context(_claimed(path))
        there = [file_of(data, service) for service in KINDS]
        there = [path for path in there if _parts(path)]
        if there and not force:
            names = ", ".join(str(path) for path in there)
            raise BackupError(f"{names}: there already; --force sets them aside and goes on")
        _bring(folder, data, manifest)
        # Last, one right after the other: until here the files are those from before.
        aside = [damage.set_aside(path, "replaced") for path in there]
        for service in manifest.files:
            path = file_of(data, service)
            Path(f"{path}.partial").rename(path)
            _sync(path.parent)
    return manifest, aside


def read_manifest(folder: Path) -> Manifest:
    """What a backup says that it holds; BackupError if it is none that this program can read."""
    try:
        values = json.loads((folder / MANIFEST).read_text())
        format_ = values.pop("format")
        if format_ != FORMAT:
            raise BackupError(
                f"{folder}: a backup of format {format_}, this program reads {FORMAT}"
            )
        files = {service: Copied(**one) for service, one in values.pop("files").items()}
        manifest = Manifest(files=files, **values)
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise BackupError(f"{folder} is not a backup: {error}") from error
    for service, one in files.items():
        if service not in KINDS or Path(one.file).name != one.file:
            raise BackupError(f"{folder} is not a backup: it names {service}, {one.file}")
        if one.version > KINDS[service][1]:
            raise BackupError(
                f"{folder / one.file} has format {one.version}, this program reads "
                f"{KINDS[service][1]}: restore it with covinz {manifest.covinz} or newer"
            )
    if "ingest" not in files:
        raise BackupError(f"{folder} is not a backup: there is no keyframe log in it")
    return manifest


def verify(folder: Path, manifest: Manifest) -> None:
    """Whether the files are those that were copied; raises BackupError."""
    for one in manifest.files.values():
        path = folder / one.file
        try:
            size, digest = path.stat().st_size, _sha256(path)
        except OSError as error:
            raise BackupError(f"the backup is not complete: {error}") from error
        if (size, digest) != (one.size_bytes, one.sha256):
            raise BackupError(f"{path} is not what was backed up: its checksum differs")


def _copy(source: Path, folder: Path, service: str) -> Copied:
    """Copy one file as it is at this moment; its writer goes on meanwhile."""
    target = folder / f"{service}.sqlite"
    application_id, newest = KINDS[service]
    try:
        with closing(durable.open_reader(source)) as db, closing(sqlite3.connect(target)) as copy:
            # All pages at once: with pauses every commit in between would start it anew.
            db.backup(copy, pages=-1)
            (found,) = copy.execute("PRAGMA application_id").fetchone()
            (version,) = copy.execute("PRAGMA user_version").fetchone()
            broken = damage.examine(copy, target, limit_bytes=sys.maxsize)
    except sqlite3.Error as error:
        raise BackupError(f"cannot copy {source}: {error}") from error
    if found != int.from_bytes(application_id, "big") or not 0 < version <= newest:
        raise BackupError(f"{source} is not a file of this version of covinz")
    if broken is not None:
        raise BackupError(f"{source} is damaged, so it is not backed up: {broken}")
    _remove_parts(folder)
    _sync(target)
    return Copied(target.name, version, target.stat().st_size, _sha256(target))


def _bring(folder: Path, data: Path, manifest: Manifest) -> None:
    """Copy the files to where they belong, beside those that are there."""
    for service, one in manifest.files.items():
        partial = Path(f"{file_of(data, service)}.partial")
        with (folder / one.file).open("rb") as source, partial.open("wb") as target:
            while chunk := source.read(_CHUNK):
                target.write(chunk)
        _sync(partial)
        if _sha256(partial) != one.sha256:
            raise BackupError(f"{partial} could not be written as it should be")


def _parts(path: Path) -> list[Path]:
    return [Path(f"{path}{part}") for part in damage.PARTS if Path(f"{path}{part}").exists()]


def _remove_parts(folder: Path) -> None:
    """Of closed copies: they are empty."""
    for part in (*folder.glob("*.sqlite-wal"), *folder.glob("*.sqlite-shm")):
        part.unlink()


@contextmanager
def _claimed(path: Path) -> Iterator[None]:
    descriptor = durable.claim(path)
    try:
        yield
    finally:
        os.close(descriptor)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
