"""The parts of the simulation do what it needs of them: disk, threads, bus."""

from __future__ import annotations

import random
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from covinz.durable import DurableFile, FileKind
from tests.simulation.disk import Disk, Layer
from tests.simulation.machine import SimulatedMachine
from tests.simulation.network import Network, SimulatedBus, Weather
from tests.simulation.scheduler import Scheduler
from tests.simulation.simulation import LAYER

KIND = FileKind("notes", b"note", 1, "CREATE TABLE note (text TEXT NOT NULL);")
NAME = "notes.sqlite"


def written(folder: Path, disk: Disk, texts: list[str], durable: list[bool]) -> DurableFile:
    LAYER.disks[str(folder)] = disk
    file = DurableFile(folder / NAME, KIND)
    for text, is_durable in zip(texts, durable, strict=True):
        with file.transaction(is_durable) as db:
            db.execute("INSERT INTO note VALUES (?)", (text * 3000,))
    return file


def read(folder: Path, image: dict[str, bytes]) -> list[str]:
    folder.mkdir()
    for name, content in image.items():
        (folder / name).write_bytes(content)
    with sqlite3.connect(folder / NAME) as db:
        assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        found = [text[0] for (text,) in db.execute("SELECT text FROM note ORDER BY rowid")]
    db.close()
    return found


@pytest.fixture
def disk(tmp_path: Path) -> Disk:
    disk = Disk(tmp_path / "process")
    disk.load({})
    return disk


def test_a_power_cut_takes_only_what_was_not_synced(tmp_path: Path, disk: Disk) -> None:
    with LAYER.installed():
        file = written(disk.folder, disk, ["a", "b", "c", "d"], [True, True, False, False])
        images = [disk.left_by_power_cut(random.Random(seed)) for seed in range(40)]
        killed = disk.left_by_kill()
        file.close()
    found = [read(tmp_path / str(n), image) for n, image in enumerate(images)]
    # Whatever is torn, what is left is a beginning that holds all that was durable.
    assert {tuple(one) for one in found} == {("a", "b"), ("a", "b", "c"), ("a", "b", "c", "d")}
    assert read(tmp_path / "killed", killed) == ["a", "b", "c", "d"]


def test_a_lying_disk_loses_what_it_called_safe(tmp_path: Path, disk: Disk) -> None:
    with LAYER.installed():
        written(disk.folder, disk, ["a"], [True]).close()
        image = disk.left_by_kill()
        again = Disk(tmp_path / "again")
        again.load(image)
        again.is_lying = True
        file = written(again.folder, again, ["b"], [True])
        images = [again.left_by_power_cut(random.Random(seed)) for seed in range(20)]
        file.close()
    assert ["a"] in [read(tmp_path / str(n), image) for n, image in enumerate(images)]


def test_a_process_dies_in_the_middle_of_a_commit(tmp_path: Path, disk: Disk) -> None:
    images: list[dict[str, bytes]] = []

    def die() -> None:
        images.append(disk.left_by_kill())
        disk.is_gone = True

    with LAYER.installed():
        file = written(disk.folder, disk, ["a"], [True])
        disk.writes_left, disk.on_fuse = 1, die
        with pytest.raises(sqlite3.OperationalError), file.transaction() as db:
            db.execute("INSERT INTO note VALUES (?)", ("b" * 9000,))
        file.close()
    assert read(tmp_path / "after", images[0]) == ["a"]


def test_a_full_disk_is_an_error(disk: Disk) -> None:
    with LAYER.installed():
        file = written(disk.folder, disk, ["a"], [True])
        disk.is_full = True
        with pytest.raises(sqlite3.OperationalError, match="full"), file.transaction() as db:
            db.execute("INSERT INTO note VALUES ('b')")
        disk.is_full = False
        with file.transaction() as db:
            db.execute("INSERT INTO note VALUES ('b')")
        file.close()


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    with Layer().installed(), sqlite3.connect(tmp_path / NAME) as db:
        db.execute("CREATE TABLE note (text TEXT)")
    db.close()
    assert (tmp_path / NAME).stat().st_size > 0


Play = Callable[..., Scheduler]


@pytest.fixture
def play() -> Play:
    """Runs functions as threads of one machine until they have ended."""

    def play(seed: int, *bodies: Callable[[SimulatedMachine], object]) -> Scheduler:
        scheduler = Scheduler(random.Random(seed))
        machine = SimulatedMachine(scheduler, "m", seed)
        tasks = [machine.thread(lambda b=b: b(machine), "t") for b in bodies]  # type: ignore[misc]
        for task in tasks:
            task.start()
        assert scheduler.run(lambda: not any(task.is_alive() for task in tasks), 1000.0)
        assert scheduler.failure is None
        return scheduler

    return play


def test_the_seed_decides_who_runs(play: Play) -> None:
    def order(seed: int) -> str:
        said: list[str] = []

        def speak(name: str, machine: SimulatedMachine) -> None:
            for _ in range(5):
                said.append(name)
                machine.scheduler.pause()

        play(seed, lambda m: speak("a", m), lambda m: speak("b", m))
        return "".join(said)

    assert order(1) == order(1)
    assert len({order(seed) for seed in range(20)}) > 10


def test_a_lock_keeps_others_out_while_its_owner_waits(play: Play) -> None:
    inside: list[int] = []

    def bodies() -> Callable[[SimulatedMachine], object]:
        locks: list[object] = []

        def body(machine: SimulatedMachine) -> None:
            if not locks:
                locks.append(machine.lock())
            with locks[0]:  # type: ignore[attr-defined]
                inside.append(1)
                assert sum(inside) == 1
                machine.sleep(1.0)
                inside.append(-1)

        return body

    body = bodies()
    scheduler = play(3, body, body, body)
    assert scheduler.now_s > 3.0


def test_waiting_ends_with_the_news_or_in_time(play: Play) -> None:
    seen: list[object] = []

    def body(machine: SimulatedMachine) -> None:
        condition, event = machine.condition(), machine.event()
        with condition:
            seen.append(condition.wait(2.0))
            seen.append(condition.wait_for(lambda: machine.scheduler.now_s > 3.0, 10.0))
        machine.scheduler.after(1.0, event.set)
        seen.append(event.wait(5.0))

    scheduler = play(1, body)
    assert seen == [False, True, True]
    assert 12.9 < scheduler.now_s < 13.1


def test_a_killed_process_does_nothing_any_more() -> None:
    scheduler = Scheduler(random.Random(1))
    machine = SimulatedMachine(scheduler, "m", 1)
    done: list[str] = []

    def body() -> None:
        try:
            machine.sleep(5.0)
            done.append("slept")
        finally:
            machine.event().set()
            done.append("went on")

    machine.thread(body, "t").start()
    scheduler.at(1.0, machine.die)
    assert scheduler.run(lambda: machine.is_dead, 10.0)
    scheduler.finish()
    assert done == []


@pytest.mark.parametrize("seed", range(5))
def test_questions_are_answered_lost_or_repeated(seed: int) -> None:
    scheduler = Scheduler(random.Random(seed))
    network = Network(scheduler, random.Random(seed))
    network.weather = Weather(loss=0.2, repeats=0.3)
    buses = [network.join(SimulatedMachine(scheduler, name, seed)) for name in ("asker", "other")]
    heard: list[bytes] = []
    answers: list[list[bytes]] = []

    def answer(query: object) -> None:
        heard.append(query.payload)  # type: ignore[attr-defined]
        query.reply(b"yes")  # type: ignore[attr-defined]

    def ask(bus: SimulatedBus) -> None:
        answers.extend(bus.ask("a/b", str(n).encode(), 1.0) for n in range(100))

    buses[1].answer("a/*", answer)
    buses[0].machine.thread(lambda: ask(buses[0]), "t").start()
    assert scheduler.run(lambda: len(answers) == 100, 1000.0)
    assert 40 < answers.count([b"yes"]) < 85
    assert answers.count([]) == 100 - answers.count([b"yes"])
    assert len(heard) > len(set(heard)) > 60


def test_who_is_cut_off_vanishes_and_comes_back() -> None:
    scheduler = Scheduler(random.Random(1))
    network = Network(scheduler, random.Random(1))
    watcher, other = (
        network.join(SimulatedMachine(scheduler, name, 1)) for name in ("watcher", "other")
    )
    seen: list[tuple[str, bool]] = []
    watcher.watch_alive("x/*", lambda key, alive: seen.append((key, alive)))
    other.declare_alive("x/1")
    scheduler.at(1.0, other.cut)
    scheduler.at(2.0, other.mend)
    scheduler.at(3.0, lambda: network.set_router(False))
    scheduler.at(4.0, lambda: network.set_router(True))
    scheduler.at(5.0, lambda: network.leave(other))
    scheduler.at(6.0, lambda: None)
    scheduler.run(lambda: scheduler.now_s >= 6.0, 10.0)
    assert seen == [("x/1", flag) for flag in (True, False, True, False, True, False)]
