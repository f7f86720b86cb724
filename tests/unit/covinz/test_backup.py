"""Backups of real files: complete or not there, checked, and nothing overwritten."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from covinz import durable
from covinz.backup import MANIFEST, BackupError, back_up, read_manifest, restore
from covinz.config import IngestConfig
from covinz.durable import DurableFileError
from services.ingest.admission import AdmittedUpload, admit_upload
from services.ingest.keyframe_log import KeyframeLog
from services.optimizer.loop_store import LoopStore
from services.place_recognition.journal import Journal
from tests.uploads import CAMERA, message


def keyframe(seq: int) -> AdmittedUpload:
    answer = admit_upload("a0", message(seq), {CAMERA.hash: CAMERA}, IngestConfig())
    assert isinstance(answer, AdmittedUpload)
    return answer


@pytest.fixture
def data(tmp_path: Path) -> Iterator[Path]:
    """Files of a server that is running."""
    folder = tmp_path / "data"
    log = KeyframeLog(folder / "ingest.sqlite")
    log.append([keyframe(seq) for seq in range(20)])
    journal, store = (
        Journal(folder / "place_recognition.sqlite"),
        LoopStore(folder / "optimizer.sqlite"),
    )
    yield folder
    for file in (log, journal, store):
        file.close()


def content(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.glob("*.sqlite*")}


def head_of(data: Path) -> int:
    log = KeyframeLog(data / "ingest.sqlite")
    log.close()
    return log.head


def test_a_backup_is_brought_back_in_an_empty_place(data: Path, tmp_path: Path) -> None:
    made = back_up(data, tmp_path / "kept")
    assert made.head == 20
    assert list(made.files) == ["place_recognition", "optimizer", "ingest"]
    assert read_manifest(tmp_path / "kept") == made
    assert {file.name for file in (tmp_path / "kept").iterdir()} == {
        MANIFEST,
        *(one.file for one in made.files.values()),
    }
    assert restore(tmp_path / "kept", tmp_path / "new") == (made, [])
    assert head_of(tmp_path / "new") == 20
    LoopStore(tmp_path / "new" / "optimizer.sqlite").close()
    Journal(tmp_path / "new" / "place_recognition.sqlite").close()


def test_it_is_of_one_moment_while_the_log_grows(tmp_path: Path) -> None:
    log = KeyframeLog(tmp_path / "data" / "ingest.sqlite")
    stop = threading.Event()
    log.append([keyframe(0)])

    def grow() -> None:
        seq = 1
        while not stop.is_set():
            log.append([keyframe(seq)])
            seq += 1

    writer = threading.Thread(target=grow)
    writer.start()
    try:
        heads = [back_up(tmp_path / "data", tmp_path / f"kept{k}").head for k in range(3)]
    finally:
        stop.set()
        writer.join()
    log.close()
    assert heads == sorted(heads)
    for k, head in enumerate(heads):
        restore(tmp_path / f"kept{k}", tmp_path / f"new{k}")
        assert head_of(tmp_path / f"new{k}") == head


def test_each_service_may_have_a_folder_of_its_own(data: Path, tmp_path: Path) -> None:
    made = back_up(data, tmp_path / "kept")
    volumes = tmp_path / "volumes"
    for name in made.files:
        (volumes / name).mkdir(parents=True)
    restore(tmp_path / "kept", volumes)
    assert all((volumes / name / f"{name}.sqlite").is_file() for name in made.files)
    assert back_up(volumes, tmp_path / "again").head == 20


def test_what_is_there_is_not_overwritten(data: Path, tmp_path: Path) -> None:
    back_up(data, tmp_path / "kept")
    with pytest.raises(BackupError, match="name a new folder"):
        back_up(data, tmp_path / "kept")
    restore(tmp_path / "kept", tmp_path / "new")
    log = KeyframeLog(tmp_path / "new" / "ingest.sqlite")
    log.append([keyframe(100)])
    log.close()
    before = content(tmp_path / "new")
    with pytest.raises(BackupError, match="--force sets them aside"):
        restore(tmp_path / "kept", tmp_path / "new")
    assert content(tmp_path / "new") == before
    _, aside = restore(tmp_path / "kept", tmp_path / "new", force=True)
    assert len(aside) == 3
    assert head_of(tmp_path / "new") == 20
    (log_aside,) = [path for path in aside if path.name.startswith("ingest")]
    assert log_aside.read_bytes() == before["ingest.sqlite"]


def test_a_running_server_is_not_restored(data: Path, tmp_path: Path) -> None:
    back_up(data, tmp_path / "kept")
    with pytest.raises(DurableFileError, match="in use by another process"):
        restore(tmp_path / "kept", data, force=True)


def test_a_backup_that_was_changed_is_refused(data: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    back_up(data, kept)
    original = (kept / "ingest.sqlite").read_bytes()
    (kept / "ingest.sqlite").write_bytes(original[:-1] + bytes([original[-1] ^ 1]))
    with pytest.raises(BackupError, match="its checksum differs"):
        restore(kept, tmp_path / "new")
    (kept / "ingest.sqlite").unlink()
    with pytest.raises(BackupError, match="not complete"):
        restore(kept, tmp_path / "new")
    assert not content(tmp_path / "new")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": 2}, "a backup of format 2"),
        ({"files": {}}, "no keyframe log"),
        ({"files": {"router": {}}}, "is not a backup"),
        ({"head": None, "extra": 1}, "is not a backup"),
    ],
)
def test_a_manifest_that_makes_no_sense_is_refused(
    data: Path, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    kept = tmp_path / "kept"
    back_up(data, kept)
    values = json.loads((kept / MANIFEST).read_text())
    (kept / MANIFEST).write_text(json.dumps(values | change))
    with pytest.raises(BackupError, match=words):
        restore(kept, tmp_path / "new")


def test_a_backup_of_a_newer_program_is_refused(data: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    back_up(data, kept)
    values = json.loads((kept / MANIFEST).read_text())
    values["files"]["ingest"]["version"] = 99
    (kept / MANIFEST).write_text(json.dumps(values))
    with pytest.raises(BackupError, match="has format 99"):
        restore(kept, tmp_path / "new")


def test_damaged_files_are_not_backed_up(data: Path, tmp_path: Path) -> None:
    back_up(data, tmp_path / "kept")
    restore(tmp_path / "kept", tmp_path / "new")
    path = tmp_path / "new" / "ingest.sqlite"
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xa5" * (path.stat().st_size - 4096))
    with pytest.raises(BackupError, match=r"ingest\.sqlite"):
        back_up(tmp_path / "new", tmp_path / "bad")
    assert not list(tmp_path.glob("bad*"))


def test_without_a_log_there_is_no_backup(tmp_path: Path) -> None:
    with pytest.raises(BackupError, match="no keyframe log"):
        back_up(tmp_path, tmp_path / "kept")


def test_a_restored_server_is_claimed_by_nobody(data: Path, tmp_path: Path) -> None:
    back_up(data, tmp_path / "kept")
    restore(tmp_path / "kept", tmp_path / "new")
    durable.claim(tmp_path / "new" / "server")
