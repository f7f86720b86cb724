"""Files of a server that are damaged, empty, foreign or too new, under real processes."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from covinz.agent import Agent
from tests.processes import PATIENCE_S, Processes
from tests.uploads import content


def garbage(path: Path) -> None:
    """Noise in the pages after the first."""
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xa5" * (size - 4096))


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def foreign(path: Path) -> None:
    path.unlink()
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE theirs (x)")
    db.close()


def newer(path: Path) -> None:
    db = sqlite3.connect(path)
    db.execute("PRAGMA user_version = 99")
    db.close()


DAMAGE: list[Callable[[Path], None]] = [garbage, emptied]
NOT_OURS: list[tuple[Callable[[Path], None], str]] = [
    (foreign, "a database of another program"),
    (newer, "of format 99, this program reads"),
]


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data of a server that was stopped in order."""
    folder = tmp_path_factory.mktemp("filled")
    with Processes(folder) as server:
        server.start("router", "ingest", "place_recognition", "optimizer")
        with Agent("a0", server.endpoint, folder / "a0.spool") as agent:
            for k in range(20):
                agent.send(content(k, num_features=50))
            assert agent.wait_delivered(PATIENCE_S)
        for name in ("ingest", "place_recognition", "optimizer"):
            assert server.stop(name) == 0
    return folder / "data"


def copy_of(filled: Path, folder: Path) -> Path:
    data = folder / "data"
    data.mkdir()
    for file in filled.iterdir():
        (data / file.name).write_bytes(file.read_bytes())
    return data


@pytest.mark.parametrize("damage", [*DAMAGE, *(damage for damage, _ in NOT_OURS)])
def test_a_damaged_log_stops_ingest_with_a_reason_and_is_left_as_it_is(
    filled: Path, tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    data = copy_of(filled, tmp_path)
    damage(data / "ingest.sqlite")
    before = (data / "ingest.sqlite").read_bytes()
    with Processes(tmp_path) as server:
        server.start("router", "optimizer")
        assert server.spawn("ingest").wait(PATIENCE_S) == 1
        assert server.spawn("ingest").wait(PATIENCE_S) == 1  # however often it is tried
        log = server.log_of("ingest")
        assert str(data / "ingest.sqlite") in log
        wanted = dict(NOT_OURS).get(damage, "restore a backup (covinz restore)")
        assert wanted in log
        assert "Traceback" not in log
        assert server.status("optimizer").cursor == 0  # the others are there
    assert (data / "ingest.sqlite").read_bytes() == before


@pytest.mark.parametrize(
    ("name", "damage"),
    [("place_recognition", garbage), ("optimizer", garbage), ("optimizer", emptied)],
)
def test_what_can_be_rebuilt_is_set_aside_and_rebuilt(
    filled: Path, tmp_path: Path, name: str, damage: Callable[[Path], None]
) -> None:
    data = copy_of(filled, tmp_path)
    damage(data / f"{name}.sqlite")
    before = (data / f"{name}.sqlite").read_bytes()
    with Processes(tmp_path) as server:
        server.start("router", "ingest", name)
        assert f"cannot use {data / name}.sqlite as a" in server.log_of(name)
        assert "what it held is computed anew" in server.log_of(name)
        (kept,) = data.glob(f"{name}.sqlite.damaged-*Z")
        assert kept.read_bytes() == before
        assert server.stop(name) == 0


@pytest.mark.parametrize(("damage", "words"), NOT_OURS)
def test_what_is_not_ours_or_too_new_is_not_replaced(
    filled: Path, tmp_path: Path, damage: Callable[[Path], None], words: str
) -> None:
    name = "optimizer"
    data = copy_of(filled, tmp_path)
    damage(data / f"{name}.sqlite")
    before = (data / f"{name}.sqlite").read_bytes()
    with Processes(tmp_path) as server:
        server.start("router", "ingest")
        assert server.spawn(name).wait(PATIENCE_S) == 1
        assert words in server.log_of(name)
    assert (data / f"{name}.sqlite").read_bytes() == before
