"""Disks that are really full: a small file system, or a limit on the size of a process's files."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

# Room for a router's, an ingest's and an optimizer's files, before it is filled.
SMALL_BYTES = 16 * 1024 * 1024


@contextmanager
def small_file_system(folder: Path) -> Iterator[None]:
    """A file system of `SMALL_BYTES` at `folder`; skips the test where that is not permitted."""
    folder.mkdir(parents=True, exist_ok=True)
    mount = shutil.which("mount")
    if mount is None or os.geteuid() != 0:
        pytest.skip("only root may mount a file system")
    options = f"size={SMALL_BYTES}"
    done = subprocess.run(
        [mount, "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True, text=True
    )
    if done.returncode:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(folder: Path) -> Callable[[], object]:
    """Take all the room that there is; returns what gives it back."""
    filler = folder / "filler"
    with filler.open("wb", buffering=0) as file:
        for chunk in (65536, 4096, 1):
            try:
                while True:
                    file.write(bytes(chunk))
            except OSError:
                continue
    return filler.unlink


def limit_files(pid: int, size_bytes: int) -> Callable[[], object]:
    """Let no file of a process grow beyond a size; returns what takes that back."""
    soft, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size_bytes, hard))
    return lambda: resource.prlimit(pid, resource.RLIMIT_FSIZE, (soft, hard))
