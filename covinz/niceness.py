"""How much a process gives way to the others on this machine for the CPU, and how soon.

Where every login or service manager's session is a group of its own for the scheduler (Linux's
autogroups), this only counts within the session, which all processes of ``covinz up`` share; the
group of a process that leads a session gets its niceness too. Where containers share a machine, the
engine's shares count instead (``cpu_shares`` in Compose).

Source: sched(7), "The autogroup feature"; sched_setattr(2); decisions 0031 and 0033.
"""

from __future__ import annotations

import ctypes
import logging
import os
import platform
import struct
import sys
from pathlib import Path

logger = logging.getLogger(__name__)

_AUTOGROUP = Path("/proc/self/autogroup")
# What Linux allows: of threads that answer, and of those that compute for long. [s]
SHORT_TURNS_S = 1e-4
LONG_TURNS_S = 0.1
# The C library has no function for it before glibc 2.41: its number, and `struct sched_attr`.
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
_SCHED_ATTR = "=IIQiIQQQ"


def give_way(niceness: int) -> None:
    """Lower the priority of this process to `niceness`; never raises it.

    The group of the session changes only where this process leads it, so that a service started
    by hand does not slow its shell.
    """
    missing = niceness - os.getpriority(os.PRIO_PROCESS, 0)
    if missing <= 0:
        return
    os.nice(missing)
    if os.getsid(0) != os.getpid():
        return
    try:
        if _AUTOGROUP.exists():
            _AUTOGROUP.write_text(str(niceness))
    except OSError as error:  # it may be switched off, or not ours to change
        logger.debug("the session's group keeps its priority: %s", error)


def take_turns(seconds: float) -> None:
    """Let this thread, and those that it starts from now on, run for about so long at a time.

    Where more threads want to run than there are processors, one with short turns that is woken
    goes before one with long turns that is at work; what each gets in all stays the same. Others
    wait for the scheduler's next tick, however short their work is. Linux from 6.12 on does so;
    elsewhere this changes nothing.

    Args:
        seconds: `SHORT_TURNS_S` to `LONG_TURNS_S`.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if not sys.platform.startswith("linux") or number is None:
        return
    if os.sched_getscheduler(0) != os.SCHED_OTHER:  # somebody has decided otherwise
        return
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    size = struct.calcsize(_SCHED_ATTR)
    attr = struct.pack(_SCHED_ATTR, size, os.SCHED_OTHER, 0, niceness, 0, int(1e9 * seconds), 0, 0)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syscall(number, 0, attr, 0):  # an old kernel, or a sandbox
        logger.debug("turns are as long as ever: %s", os.strerror(ctypes.get_errno()))
