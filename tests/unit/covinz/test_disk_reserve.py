"""Room kept on the disk: held, given up, and done without where it cannot be had."""

from __future__ import annotations

from pathlib import Path

from covinz.disk_reserve import DiskReserve


def test_it_takes_room_and_gives_it_up(tmp_path: Path) -> None:
    reserve = DiskReserve(tmp_path / "room", 100_000)
    for _ in range(2):
        assert reserve.take() and reserve.take()
        assert (tmp_path / "room").stat().st_blocks * 512 >= 100_000
        reserve.give_up()
        reserve.give_up()
        assert list(tmp_path.iterdir()) == []


def test_a_disk_without_so_much_room(tmp_path: Path) -> None:
    assert not DiskReserve(tmp_path / "room", 2**43).take()
    assert list(tmp_path.iterdir()) == []


def test_a_place_where_no_file_can_be(tmp_path: Path) -> None:
    assert DiskReserve(tmp_path / "none" / "room", 100).take()
