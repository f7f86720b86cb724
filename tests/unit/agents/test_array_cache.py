"""Cached arrays: made once, made again when damaged, used without a cache that can be written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from covinz_agents import array_cache, features, selection
from covinz_agents.array_cache import cached_array
from covinz_agents.cache_folder import cache_folder, source_digest
from numpy.typing import NDArray


class Maker:
    """Makes an array and counts how often."""

    def __init__(self, size: int = 10) -> None:
        self.calls = 0
        self._size = size

    def __call__(self) -> NDArray[np.generic]:
        self.calls += 1
        return np.arange(self._size, dtype=np.uint8)


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COVINZ_CACHE", str(tmp_path))


def test_an_array_is_made_once() -> None:
    make = Maker()
    first, second = cached_array("x", "k", make), cached_array("x", "k", make)
    assert make.calls == 1
    assert np.array_equal(first, second)
    cached_array("x", "other", make)
    assert make.calls == 2


@pytest.mark.parametrize("damage", [b"", b"\x93NUMPY\x01\x00", b"nonsense"])
def test_a_damaged_file_is_made_again(tmp_path: Path, damage: bytes) -> None:
    make = Maker()
    cached_array("x", "k", make)
    (tmp_path / "x" / "k.npy").write_bytes(damage)
    assert np.array_equal(cached_array("x", "k", make), np.arange(10))
    assert np.array_equal(cached_array("x", "k", make), np.arange(10))
    assert make.calls == 2


def test_where_nothing_can_be_written_it_is_made_every_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("COVINZ_CACHE", str(tmp_path / "file"))
    make = Maker()
    for _ in range(2):
        assert np.array_equal(cached_array("x", "k", make), np.arange(10))
    assert make.calls == 2


def test_what_was_used_longest_ago_gives_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(array_cache, "_CAPACITY", 3000)
    for key in ("a", "b", "a", "c"):
        cached_array("x", key, Maker(1000))
    assert sorted(path.stem for path in (tmp_path / "x").iterdir()) == ["a", "c"]


def test_the_folder_is_the_chosen_one_or_the_users(tmp_path: Path) -> None:
    chosen = {"COVINZ_CACHE": str(tmp_path / "a"), "XDG_CACHE_HOME": str(tmp_path / "b")}
    assert cache_folder("k", chosen) == tmp_path / "a" / "k"
    del chosen["COVINZ_CACHE"]
    assert cache_folder("k", chosen) == tmp_path / "b" / "covinz" / "k"


def test_the_digest_of_sources_differs_between_modules() -> None:
    assert source_digest([features]) == source_digest([features])
    assert len({source_digest([features]), source_digest([features, selection])}) == 2
