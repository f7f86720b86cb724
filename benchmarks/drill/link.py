"""A network between robots and server whose weather can be made: two namespaces and a cable.

This process makes two network namespaces, each with a TUN device, and carries the packets from one
to the other, as the weather has it. Above are the kernel's own TCP and UDP and the real QUIC. The
namespaces have no names and end with their last process, whatever ends it. (Not `tc netem`: it is
missing in many kernels, of virtual machines above all.)

    python -m benchmarks.drill.link SEED

It says `{"ns": [file of the server's namespace, of the robots']}`, then does what it reads, line by
line: the JSON of a `Weather`, answered by `{"carried": packets so far, "dropped": ...}`.

Source: Linux, networking/tuntap.rst; TUN without packet information, one read a packet.
"""

from __future__ import annotations

import ctypes
import fcntl
import heapq
import json
import os
import random
import select
import struct
import subprocess
import sys
import time
from dataclasses import dataclass

SERVER_HOST = "10.77.0.1"
ROBOTS_HOST = "10.77.0.2"
_CLONE_NEWNET = 0x40000000
_TUNSETIFF = 0x400454CA
_IFF_TUN, _IFF_NO_PI = 0x0001, 0x1000
_MTU = 1500
# One way, also in fair weather: a Wi-Fi's round trip is about 10 ms.
_DELAY_S = 0.005
# Packets that wait for a slow link; those beyond are dropped, as a router does. [bytes]
_QUEUE_BYTES = 128 * 1024


@dataclass(frozen=True, slots=True)
class Weather:
    """What happens to packets, in both directions.

    Attributes:
        loss: Share that is lost.
        repeats: Share that arrives twice.
        late: Share that is overtaken by those of the next 20 ms.
        down: Whether all are lost.
        mbit_per_s: What the link carries; None: as much as there is.
    """

    loss: float = 0.0
    repeats: float = 0.0
    late: float = 0.0
    down: bool = False
    mbit_per_s: float | None = None


FAIR = Weather()
_LATE_S = 0.02


class Direction:
    """Packets from one device to the other."""

    def __init__(self, source: int, target: int, draw: random.Random) -> None:
        self.source = source
        self.carried = self.dropped = 0
        self._target = target
        self._draw = draw
        self._number = 0
        self._free_at = 0.0
        self._waiting: list[tuple[float, int, bytes]] = []

    def take(self, now: float, weather: Weather) -> None:
        """Read a packet, and carry it at once, later or never."""
        packet = os.read(self.source, _MTU + 64)
        due = now
        if weather.mbit_per_s is not None:
            bytes_per_s = weather.mbit_per_s * 1e6 / 8
            self._free_at = max(now, self._free_at)
            if (self._free_at - now) * bytes_per_s > _QUEUE_BYTES:
                self.dropped += 1
                return
            self._free_at += len(packet) / bytes_per_s
            due = self._free_at
        if weather.down or self._draw.random() < weather.loss:
            self.dropped += 1
            return
        due += _DELAY_S
        if self._draw.random() < weather.late:
            due += _LATE_S * self._draw.random()
        for _ in range(1 + (self._draw.random() < weather.repeats)):
            self._number += 1
            heapq.heappush(self._waiting, (due, self._number, packet))

    def deliver(self, now: float) -> float | None:
        """Write what is due; returns when the next packet will be."""
        while self._waiting and self._waiting[0][0] <= now:
            _, _, packet = heapq.heappop(self._waiting)
            try:
                os.write(self._target, packet)
                self.carried += 1
            except OSError:  # the device's own queue is full
                self.dropped += 1
        return self._waiting[0][0] if self._waiting else None


def open_end(address: str) -> tuple[int, int]:
    """Enter a new network namespace with a device in it; returns the namespace and the device."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_CLONE_NEWNET) != 0:
        raise OSError(ctypes.get_errno(), "cannot make a network namespace")
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", b"cable", _IFF_TUN | _IFF_NO_PI))
    network = f"{address.rpartition('.')[0]}.0/24"
    for words in (
        "link set dev lo up",
        f"address add {address}/24 dev cable",
        f"link set dev cable mtu {_MTU} txqueuelen 1000 up",
        # What Linux does unless told otherwise, whatever this machine was told.
        f"route change {network} dev cable src {address} congctl cubic",
    ):
        subprocess.run(["ip", *words.split()], check=True)
    return os.open("/proc/self/ns/net", os.O_RDONLY), device


def carry(ends: tuple[int, int], seed: int) -> None:
    """Carry packets until standard input ends."""
    draw = random.Random(seed)
    directions = [Direction(a, b, draw) for a, b in (ends, ends[::-1])]
    weather = FAIR
    poll = select.poll()
    for file in (0, *ends):
        poll.register(file, select.POLLIN)
    due: float | None = None
    while True:
        wait_ms = None if due is None else max(0.0, 1e3 * (due - time.monotonic()))
        ready = {file for file, _ in poll.poll(wait_ms)}
        now = time.monotonic()
        if 0 in ready:
            line = sys.stdin.readline()
            if not line:
                return
            weather = Weather(**json.loads(line))
            counts = {
                "carried": sum(d.carried for d in directions),
                "dropped": sum(d.dropped for d in directions),
            }
            say(**counts)
        for direction in directions:
            if direction.source in ready:
                direction.take(now, weather)
        later = [direction.deliver(now) for direction in directions]
        due = min((when for when in later if when is not None), default=None)


def say(**what: object) -> None:
    """One line to whoever started this process."""
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Make the network and carry its packets."""
    server, robots = open_end(SERVER_HOST), open_end(ROBOTS_HOST)
    here = f"/proc/{os.getpid()}/fd"
    say(ns=[f"{here}/{server[0]}", f"{here}/{robots[0]}"])
    carry((server[1], robots[1]), int(sys.argv[1]))


if __name__ == "__main__":
    main()
