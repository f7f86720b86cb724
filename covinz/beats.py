"""Heartbeats of a process to whoever started it, in the protocol of systemd's `sd_notify`.

Datagrams on the socket that the environment names in ``NOTIFY_SOCKET``: ``covinz up`` listens to
its children there, and so does systemd to a service with ``WatchdogSec=``. The kernel says which
process has sent a datagram.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import struct
import sys
from collections.abc import Mapping

VARIABLE = "NOTIFY_SOCKET"
ALIVE = "WATCHDOG=1"

# A process may take so long to its first heartbeat: it reads its program, perhaps on a busy
# machine. [s]
BIRTH_S = 60.0

_CREDENTIALS = struct.Struct("iII")  # pid, uid, gid
_MAX_BYTES = 256


class Beats:
    """The sending side; does nothing in a process that nobody listens to.

    Args:
        address: As in ``NOTIFY_SOCKET``: a path, or a name after ``@``; None: nobody listens.
    """

    def __init__(self, address: str | None) -> None:
        self._address: str | None = None
        if address and address[0] in "/@":
            self._address = "\0" + address[1:] if address[0] == "@" else address

    @classmethod
    def of_process(cls) -> Beats:
        """Of this process, to whoever started it."""
        return cls(os.environ.get(VARIABLE))

    def send(self, state: str = ALIVE) -> None:
        """Send one; a listener that is gone or busy misses it."""
        if self._address is None:
            return
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender,
        ):
            sender.setblocking(False)
            sender.sendto(state.encode(), self._address)


class BeatListener:
    """The listening side, for any number of processes of this machine.

    Attributes:
        environment: What processes need to be heard; empty where the system has no such sockets.
    """

    def __init__(self) -> None:
        self.environment: Mapping[str, str] = {}
        self._socket: socket.socket | None = None
        if not sys.platform.startswith("linux"):
            return
        name = f"covinz-{secrets.token_hex(8)}"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._socket.bind(f"\0{name}")
        self.environment = {VARIABLE: f"@{name}"}

    @property
    def hears(self) -> bool:
        """Whether heartbeats can come at all."""
        return self._socket is not None

    def receive(self, timeout_s: float) -> int | None:
        """The process of the next datagram, or None when there is none in time."""
        if self._socket is None:
            return None
        self._socket.settimeout(timeout_s)
        try:
            _, ancillary, _, _ = self._socket.recvmsg(
                _MAX_BYTES, socket.CMSG_SPACE(_CREDENTIALS.size)
            )
        except (TimeoutError, BlockingIOError):
            return None
        for level, kind, data in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, socket.SCM_CREDENTIALS):
                pid, _, _ = _CREDENTIALS.unpack(data[: _CREDENTIALS.size])
                return int(pid)
        return None

    def close(self) -> None:
        """Listen no more."""
        if self._socket is not None:
            self._socket.close()


class Hearts:
    """When each of some processes was last heard; times are in seconds of one monotonic clock.

    Args:
        silent_s: A process that was not heard for so long does not run any more.
    """

    def __init__(self, silent_s: float) -> None:
        self._silent_s = silent_s
        self._until_s: dict[int, float] = {}
        self._listened_s: float | None = None

    def born(self, pid: int, now_s: float) -> None:
        """A process was started that will send heartbeats."""
        self._until_s[pid] = now_s + BIRTH_S

    def died(self, pid: int) -> None:
        """A process has ended."""
        self._until_s.pop(pid, None)

    def heard(self, pid: int | None, now_s: float) -> set[int]:
        """Note a heartbeat (None: there was none just now); the processes that are silent.

        Time in which nobody listened, because this process did not run itself, does not count.
        """
        missed_s = 0.0 if self._listened_s is None else now_s - self._listened_s
        self._listened_s = now_s
        if missed_s > self._silent_s / 2:
            for each in self._until_s:
                self._until_s[each] += missed_s
        if pid in self._until_s:
            self._until_s[pid] = now_s + self._silent_s
        return {each for each, until_s in self._until_s.items() if now_s > until_s}
