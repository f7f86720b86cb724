"""The image cache: what is written is read, faults are misses, the folder stays bounded."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from covinz_agents.image_cache import ImageCache
from numpy.typing import NDArray


def picture(seed: int = 0) -> NDArray[np.uint8]:
    small = np.random.default_rng(seed).integers(256, size=(3, 4, 3), dtype=np.uint8)
    return np.kron(small, np.ones((8, 8, 1), dtype=np.uint8))


def test_what_is_written_is_read_to_the_last_bit(tmp_path: Path) -> None:
    cache = ImageCache(tmp_path)
    assert cache.read("a") is None
    assert "a" not in cache
    kept = cache.write("a", picture())
    read = ImageCache(tmp_path).read("a")
    assert read is not None
    assert "a" in cache
    assert read.shape == (24, 32, 3)
    assert np.array_equal(read, kept)
    # Coded as a camera does: hardly anything is lost.
    assert np.abs(kept.astype(int) - picture()).mean() < 8
    assert [path.name for path in tmp_path.iterdir()] == ["a.jpg"]


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "text"])
def test_a_damaged_file_is_a_miss_and_can_be_written_again(tmp_path: Path, damage: str) -> None:
    cache = ImageCache(tmp_path)
    kept = cache.write("a", picture())
    path = tmp_path / "a.jpg"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    damaged = {"cut": data[:-5], "flipped": data, "empty": b"", "text": b"not an image at all"}
    path.write_bytes(bytes(damaged[damage]))
    assert cache.read("a") is None
    assert "a" not in cache
    cache.write("a", picture())
    again = cache.read("a")
    assert again is not None
    assert np.array_equal(again, kept)


def test_what_was_not_used_for_longest_goes_first(tmp_path: Path) -> None:
    for number, key in enumerate("abc"):
        ImageCache(tmp_path).write(key, picture(number))
        os.utime(tmp_path / f"{key}.jpg", ns=(number, number))
    size = sum(path.stat().st_size for path in tmp_path.iterdir())
    cache = ImageCache(tmp_path, max_bytes=size - 1)
    assert cache.read("a") is not None  # now b is the oldest
    cache.prune()
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["a", "c"]
    cache.prune()
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["a", "c"]


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="gone"):
        ImageCache(tmp_path / "gone").write("a", picture())
