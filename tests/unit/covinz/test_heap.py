from __future__ import annotations

import platform
import subprocess
import sys

import pytest

# In a thread, as solvers work: its heap is another than the process's first.
FAULTS = """
import ctypes, resource, sys, threading
from covinz.heap import keep_freed_memory

if sys.argv[1] == "keep":
    keep_freed_memory()
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]

def take_and_free():
    for _ in range(20):
        blocks = [libc.malloc(1 << 20) for _ in range(4)]
        for block in blocks:
            ctypes.memset(block, 1, 1 << 20)
        for block in blocks:
            libc.free(block)

before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
thread = threading.Thread(target=take_and_free)
thread.start()
thread.join()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(how: str) -> int:
    argv = [sys.executable, "-c", FAULTS, how]
    return int(subprocess.run(argv, check=True, capture_output=True, text=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc's malloc can be told")
def test_freed_memory_is_taken_again_without_page_faults() -> None:
    assert faults("keep") < 0.5 * faults("release")
