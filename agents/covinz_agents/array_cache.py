"""Arrays that take long to make, kept on disk between runs."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from covinz_agents.cache_folder import cache_folder

# The arrays used last are kept, up to this size in all. [bytes]
_CAPACITY = 2_000_000_000


def cached_array(
    kind: str, key: str, make: Callable[[], NDArray[np.generic]]
) -> NDArray[np.generic]:
    """The array of a key: read from the cache, or made and kept there.

    A cache that cannot be written costs time, not the result.

    Args:
        kind: Name of a folder in the cache.
        key: Name of the file: a digest of everything that the array depends on.
        make: Makes it; called if it is not there or damaged.
    """
    with contextlib.suppress(OSError, ValueError, EOFError):
        return _read(cache_folder(kind) / f"{key}.npy")
    made = make()
    with contextlib.suppress(OSError):
        _write(cache_folder(kind) / f"{key}.npy", made)
        _prune(cache_folder(kind))
    return made


def _read(path: Path) -> NDArray[np.generic]:
    array: NDArray[np.generic] = np.load(path, allow_pickle=False)
    # The time of its last use, by which `_prune` goes.
    os.utime(path)
    return array


def _write(path: Path, array: NDArray[np.generic]) -> None:
    """Write a file that is there as a whole or not at all, whoever else writes it."""
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
        try:
            np.save(file, array)
            file.close()
            Path(file.name).replace(path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise


def _prune(folder: Path) -> None:
    """Remove what was used longest ago."""
    kept = 0
    files = [(path.stat(), path) for path in folder.glob("*.npy")]
    for status, path in sorted(files, key=lambda item: -item[0].st_mtime_ns):
        kept += status.st_size
        if kept > _CAPACITY:
            path.unlink(missing_ok=True)
