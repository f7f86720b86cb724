"""Simulated processes: started, killed, frozen, cut off and started again, with what is on disk."""

from __future__ import annotations

import random
import zlib
from collections.abc import Callable
from pathlib import Path

from covinz.bus import Bus
from tests.simulation.disk import Disk, Layer
from tests.simulation.machine import SimulatedMachine
from tests.simulation.network import LINK_LEASE_S, Network, SimulatedBus
from tests.simulation.scheduler import Scheduler

# Whoever ends by itself is started again after this. [s; covinz.supervisor does the same]
RESTART_S = 0.5

Main = Callable[[SimulatedMachine, Bus, Path], int]
Wrap = Callable[[str, Bus], Bus]


class Process:
    """A process that is started again whenever it ends.

    Attributes:
        machine: Of the current run, or of the last one.
        bus: The same.
        disk: The same.
        num_runs: How often it was started.
        is_running: It is neither dead nor waiting to be started again.
        had_full_disk: Its disk was full at some time of this run: then it may fail.
        has_lying_disk: Its disk says that it has synced and has not.
    """

    machine: SimulatedMachine
    bus: SimulatedBus
    disk: Disk

    def __init__(
        self,
        name: str,
        seed: int,
        main: Main,
        scheduler: Scheduler,
        network: Network,
        layer: Layer,
        folder: Path,
        wrap: Wrap,
    ) -> None:
        self.name = name
        self.num_runs = 0
        self.is_running = False
        self.had_full_disk = False
        self.has_lying_disk = False
        self._seed = zlib.crc32(f"{seed} {name}".encode())
        self._draw = random.Random(self._seed)
        self._main = main
        self._scheduler = scheduler
        self._network = network
        self._layer = layer
        self._folder = folder
        self._wrap = wrap
        self._image: dict[str, bytes] = {}
        self._backup: dict[str, bytes] = {}
        self._is_disk_full = False
        self._clock_offset_ns = 0

    def start(self) -> None:
        """Start it, if it does not run."""
        if self.is_running:
            return
        self.is_running = True
        self.num_runs += 1
        self.machine = SimulatedMachine(self._scheduler, self.name, self._seed + self.num_runs)
        self.machine.clock_offset_ns = self._clock_offset_ns
        self.bus = self._network.join(self.machine)
        self.disk = Disk(self._folder / f"{self.name}-{self.num_runs}")
        self.disk.load(self._image)
        self.disk.is_lying = self.has_lying_disk
        self.disk.is_full = self.had_full_disk = self._is_disk_full
        self._layer.disks[str(self.disk.folder)] = self.disk
        self._network.trace("starts", self.name, "")
        machine, bus, folder = self.machine, self._wrap(self.name, self.bus), self.disk.folder
        machine.thread(lambda: self._run(machine, bus, folder), "main").start()

    def kill(self, restart_s: float, is_power_cut: bool = False) -> None:
        """It ends at once, and is started again later."""
        if not self.is_running:
            return
        self._network.trace("power cut" if is_power_cut else "killed", self.name, "")
        disk = self.disk
        self._image = disk.left_by_power_cut(self._draw) if is_power_cut else disk.left_by_kill()
        self._end()
        self._scheduler.after(restart_s, self.start)

    def lose_disk(self, restart_s: float) -> None:
        """It ends at once, and everything that it had on its disk is gone."""
        self._network.trace("loses its disk", self.name, "")
        self.kill(restart_s)
        self._image = {}

    def back_up(self) -> None:
        """Copy its disk as it is now."""
        self._backup = self.disk.left_by_kill() if self.is_running else dict(self._image)

    def roll_back(self, restart_s: float) -> None:
        """It ends at once, and its disk is again as it was when it was backed up."""
        self._network.trace("rolled back", self.name, "")
        self.kill(restart_s)
        self._image = dict(self._backup)

    def kill_at_write(self, writes: int, restart_s: float, is_power_cut: bool) -> None:
        """The same, in the middle of a commit: `writes` writes from now."""
        if self.is_running:
            self.disk.writes_left = writes
            self.disk.on_fuse = lambda: self.kill(restart_s, is_power_cut)

    def hang(self, lasts_s: float) -> None:
        """No thread of it runs for a while, and its connection is given up if that is long."""
        machine, bus = self.machine, self.bus
        if not self.is_running or machine.is_frozen:
            return
        machine.is_frozen = True
        self._network.trace("hangs", self.name, "")

        def thaw() -> None:
            machine.is_frozen = False
            if not machine.is_dead:
                self._network.trace("goes on", self.name, "")
                bus.mend()
                bus.thaw()

        if lasts_s > LINK_LEASE_S:
            self._scheduler.after(LINK_LEASE_S, bus.cut)
        self._scheduler.after(lasts_s, thaw)

    def cut_off(self, lasts_s: float) -> None:
        """Its link to the router is broken for a while."""
        if self.is_running:
            self._network.trace("cut off", self.name, "")
            self.bus.cut()
            self._scheduler.after(lasts_s, self.bus.mend)

    def fill_disk(self, lasts_s: float) -> None:
        """Nothing can be written for a while."""
        self._is_disk_full = self.disk.is_full = self.had_full_disk = True
        self._network.trace("disk full", self.name, "")

        def empty() -> None:
            self._is_disk_full = self.disk.is_full = False

        self._scheduler.after(lasts_s, empty)

    def set_clock(self, seconds: int) -> None:
        """Its wall clock jumps."""
        self._clock_offset_ns += seconds * 10**9
        self.machine.clock_offset_ns = self._clock_offset_ns

    def end_for_ever(self) -> None:
        """The simulation is over."""
        if self.is_running:
            self._end()

    def _run(self, machine: SimulatedMachine, bus: Bus, folder: Path) -> None:
        code = self._main(machine, bus, folder)
        if not self.had_full_disk:
            self._scheduler.fail(f"{self.name} ended by itself with code {code}")
        self.kill(RESTART_S)

    def _end(self) -> None:
        self.is_running = False
        self.disk.is_gone = True
        self._network.leave(self.bus)
        self.machine.die()
