"""Files of ours: kind, version, one owner, all or nothing."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from covinz.damage import CommitFailed, Trouble, rebuildable
from covinz.durable import DamagedFile, DurableFile, DurableFileError, FileKind, open_reader

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


def made(path: Path) -> Path:
    """A file with a few pages of numbers, closed in order."""
    file = DurableFile(path, KIND)
    with file.transaction() as db:
        db.executemany("INSERT INTO number VALUES (?)", [(k,) for k in range(5000)])
    file.close()
    return path


def garbage(path: Path) -> None:
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xa5" * (size - 4096))


def no_header(path: Path) -> None:
    with path.open("r+b") as file:
        file.write(b"\xa5" * 4096)


def cut_off(path: Path) -> None:
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 2)


def emptied(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("damage", [garbage, no_header, cut_off, emptied])
def test_a_damaged_file_is_named_and_left_as_it_is(
    tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    path = made(tmp_path / "f")
    damage(path)
    before = path.read_bytes()
    for _ in range(2):
        with pytest.raises(DamagedFile, match=r"f as a test file: .*restore a backup"):
            DurableFile(path, KIND)
        assert path.read_bytes() == before


@pytest.mark.parametrize("damage", [garbage, no_header, cut_off, emptied])
def test_a_damaged_file_that_can_be_rebuilt_is_set_aside(
    tmp_path: Path, damage: Callable[[Path], None], caplog: pytest.LogCaptureFixture
) -> None:
    path = made(tmp_path / "f")
    damage(path)
    before = path.read_bytes()
    file = rebuildable(path, lambda: DurableFile(path, KIND), DamagedFile)
    assert values(file.db) == []
    file.close()
    (kept,) = tmp_path.glob("f.damaged-*Z")
    assert kept.read_bytes() == before
    assert str(kept) in caplog.text


def test_the_rest_of_a_damaged_file_goes_with_it(tmp_path: Path) -> None:
    """An old -wal file beside a new file would be taken for the new one's."""
    path = made(tmp_path / "f")
    no_header(path)
    (tmp_path / "f-wal").write_bytes(b"old")
    rebuildable(path, lambda: DurableFile(path, KIND), DamagedFile).close()
    (kept,) = tmp_path.glob("f.damaged-*-wal")
    assert kept.read_bytes() == b"old"


def test_a_file_whose_making_was_interrupted_is_made(tmp_path: Path) -> None:
    (tmp_path / "f").write_bytes(b"")
    assert values(DurableFile(tmp_path / "f", KIND).db) == []


def test_an_older_file_is_upgraded_at_once_or_not_at_all(tmp_path: Path) -> None:
    made(tmp_path / "f")

    def fail(db: sqlite3.Connection) -> None:
        db.execute("DROP TABLE number")
        raise sqlite3.OperationalError("disk full")

    def add(db: sqlite3.Connection) -> None:
        db.execute("INSERT INTO number VALUES (-1)")

    with pytest.raises(DurableFileError, match="disk full"):
        DurableFile(tmp_path / "f", replace(KIND, version=4, upgrades=(fail,)))
    newer = replace(KIND, version=5, upgrades=(add, add))
    for _ in range(2):
        file = DurableFile(tmp_path / "f", newer)
        assert values(file.db)[:3] == [-1, -1, 0]
        file.close()
    with pytest.raises(DurableFileError, match="format 5, this program reads format 3"):
        DurableFile(tmp_path / "f", KIND)


def test_a_full_disk_and_a_damaged_file_are_told_apart(tmp_path: Path) -> None:
    file = DurableFile(tmp_path / "f", KIND)
    (pages,) = file.db.execute("PRAGMA page_count").fetchone()
    file.db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(sqlite3.Error) as caught, file.transaction() as db:
        db.executemany("INSERT INTO number VALUES (?)", [(k,) for k in range(5000)])
    assert CommitFailed(tmp_path / "f", caught.value).trouble is Trouble.DISK_FULL
    assert not file.db.in_transaction
    file.close()
    assert Trouble.of(sqlite3.DatabaseError()) is Trouble.OTHER
