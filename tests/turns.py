"""What the scheduler was told of a thread's turns: see `covinz.niceness.take_turns`."""

from __future__ import annotations

import ctypes
import platform
import struct

import pytest

_SCHED_GETATTR = {"x86_64": 315, "aarch64": 275}


def turn_s(thread: int) -> float:
    """How long the turns of a thread are [s]; 0 is the calling thread. Skips where none can say."""
    attr = ctypes.create_string_buffer(56)
    number = _SCHED_GETATTR.get(platform.machine())
    if number is None or ctypes.CDLL(None).syscall(number, thread, attr, len(attr), 0):
        pytest.skip("the length of turns is not known here")
    turn_ns = struct.unpack_from("=IIQiIQ", attr)[5]
    if turn_ns == 0:
        pytest.skip("this kernel knows no turns: Linux from 6.12 on does")
    return 1e-9 * float(turn_ns)
