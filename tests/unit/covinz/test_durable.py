"""Files of ours: kind, version, one owner, all or nothing."""

from __future__ import annotations

import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest

from covinz.durable import DurableFile, DurableFileError, FileKind, open_reader

KIND = FileKind("test file", b"tstF", 3, "CREATE TABLE number (value INTEGER NOT NULL);")


def values(db: sqlite3.Connection) -> list[int]:
    return [value for (value,) in db.execute("SELECT value FROM number ORDER BY value")]


def test_what_was_committed_is_there_after_reopening(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "file#1.sqlite"
    file = DurableFile(path, KIND)
    with file.transaction() as db:
        db.execute("INSERT INTO number VALUES (1)")
    with file.transaction(durable=False) as db:
        db.execute("INSERT INTO number VALUES (2)")
    file.close()
    again = DurableFile(path, KIND)
    assert values(again.db) == [1, 2]
    again.close()


def test_commits_wait_for_the_disk_unless_told_otherwise(tmp_path: Path) -> None:
    file = DurableFile(tmp_path / "f", KIND)
    for durable, level in ((True, 2), (False, 1), (True, 2)):
        with file.transaction(durable) as db:
            assert db.execute("PRAGMA synchronous").fetchone() == (level,)
            assert db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    file.close()


def test_a_failed_block_leaves_nothing(tmp_path: Path) -> None:
    file = DurableFile(tmp_path / "f", KIND)
    with pytest.raises(ZeroDivisionError), file.transaction() as db:
        db.execute("INSERT INTO number VALUES (1)")
        _ = 1 / 0
    assert values(file.db) == []
    file.close()


def test_only_one_owner(tmp_path: Path) -> None:
    file = DurableFile(tmp_path / "f", KIND)
    with pytest.raises(DurableFileError, match="in use by another process"):
        DurableFile(tmp_path / "f", KIND)
    file.close()
    DurableFile(tmp_path / "f", KIND).close()


def test_a_reader_sees_commits_and_cannot_write(tmp_path: Path) -> None:
    file = DurableFile(tmp_path / "f", KIND)
    reader = open_reader(tmp_path / "f")
    with file.transaction() as db:
        db.execute("INSERT INTO number VALUES (1)")
        assert values(reader) == []
    assert values(reader) == [1]
    with pytest.raises(sqlite3.OperationalError, match="readonly"):
        reader.execute("INSERT INTO number VALUES (2)")
    reader.close()
    file.close()


def test_files_of_another_kind_or_version_are_refused(tmp_path: Path) -> None:
    DurableFile(tmp_path / "f", KIND).close()
    with pytest.raises(DurableFileError, match="is not a other file"):
        DurableFile(tmp_path / "f", replace(KIND, name="other file", application_id=b"othr"))
    with pytest.raises(DurableFileError, match="format 3, this program reads format 2"):
        DurableFile(tmp_path / "f", replace(KIND, version=2))
    DurableFile(tmp_path / "f", KIND).close()  # a refusal leaves no lock behind


def test_a_file_that_is_no_database_is_refused_untouched(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"holiday pictures" * 100)
    with pytest.raises(DurableFileError, match="not a database"):
        DurableFile(path, KIND)
    assert path.read_bytes() == b"holiday pictures" * 100


def test_a_database_of_somebody_else_is_refused(tmp_path: Path) -> None:
    db = sqlite3.connect(tmp_path / "f")
    db.execute("CREATE TABLE theirs (x)")
    db.close()
    with pytest.raises(DurableFileError, match="is not a test file"):
        DurableFile(tmp_path / "f", KIND)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(DurableFileError, match="cannot open"):
        DurableFile(tmp_path / "file" / "f", KIND)
