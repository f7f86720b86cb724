"""Memory that a process has freed and will soon want again stays with it."""

from __future__ import annotations

import ctypes
import sys

# Of glibc's malloc.h. Blocks below the second threshold come from the heap, which gives its end
# back to the system when so much of it is free.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES = 64 << 20
_LARGE_BYTES = 32 << 20  # the most that glibc allows


def keep_freed_memory() -> None:
    """Keep up to 64 MiB that are free, for who takes and frees megabytes many times a second.

    Otherwise each new block of them costs a page fault for every 4 kB. Only with glibc; elsewhere
    this changes nothing.

    Source: mallopt(3).
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
