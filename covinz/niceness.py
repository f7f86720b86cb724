"""How much a process gives way to the others on this machine for the CPU.

Where every login or service manager's session is a group of its own for the scheduler (Linux's
autogroups), a process's niceness only counts within its session; then the group gets it too. Where
containers share a machine, the engine's shares count instead (``cpu_shares`` in Compose).

Source: sched(7), "The autogroup feature".
"""

from __future__ import annotations

import logging
import os
from pathlib import Path

logger = logging.getLogger(__name__)

_AUTOGROUP = Path("/proc/self/autogroup")


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
