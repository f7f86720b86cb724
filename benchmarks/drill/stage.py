"""What a case plays on, and what can go wrong there: each fault is a method that makes it."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.drill.fleet import RobotProcess
from benchmarks.drill.link import FAIR, Weather
from benchmarks.drill.network import Network
from benchmarks.drill.server import CHECKOUT, Server
from covinz.supervisor import child_environment, die_with_parent

# Keyframes per second of the robot that is on its way while things break.
RATE = 4.0
# A robot that was killed is started again after this long, as by its own computer. [s]
_RESTART_S = 1.0
# So long is waited for a job to be under way; jobs come with nearly every keyframe. [s]
_AT_WORK_S = 3.0
# Longer than any wait that is not a failure. [s]
PATIENCE_S = 90.0


@dataclass(eq=False)
class Stage:
    """One case under way.

    A fault returns when its cause ended, in seconds of the monotonic clock.

    Attributes:
        folder: For what is left to look at.
        keyframes: Folder of the recording.
        spools: Folder for the spools, on a disk that may be small.
        data: The server's folder, likewise.
        server: The server.
        network: What is between it and the robots; None: this machine.
        robots: All that ran, the latest last.
    """

    folder: Path
    keyframes: Path
    spools: Path
    data: Path
    server: Server
    network: Network | None
    robots: list[RobotProcess] = field(default_factory=list)
    _pause: threading.Event = field(default_factory=threading.Event)
    _helpers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def robot(self) -> RobotProcess:
        """The robot that is on its way."""
        return self.robots[-1]

    def start_robot(
        self, agent: str, *options: str, module: str = "benchmarks.drill.robot"
    ) -> RobotProcess:
        """Start a robot's process."""
        argv = [module, agent, "--keyframes", str(self.keyframes)]
        argv += ["--spool", str(self.spools / f"{agent}.spool"), "--way", self.server.way(agent)]
        prefix = self.network.on_robots_side if self.network else ()
        log = self.folder / f"{agent}.log"
        self.robots.append(RobotProcess([*argv, *options], log, prefix))
        return self.robot

    def close(self) -> None:
        """End what was started."""
        for robot in self.robots:
            robot.close()
        for helper in self._helpers:
            helper.send_signal(signal.SIGTERM)
            helper.wait()

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self._pause.wait(seconds)

    def nothing(self) -> float:
        """No fault."""
        return time.monotonic()

    def kill(self, *names: str) -> float:
        """Kill -9 processes of the server; loop solvers while one of them is at work."""
        self.server.wait_at_work(names, _AT_WORK_S)
        return self.server.signal(names, signal.SIGKILL)

    def hang(self, *names: str) -> float:
        """Freeze processes of the server for ever; the cause is over with their last step."""
        return self.server.signal(names, signal.SIGSTOP)

    def weather(self, weather: Weather, seconds: float) -> float:
        """Other weather on the link for a while."""
        assert self.network is not None
        self.network.change(weather)
        self.wait(seconds)
        return self.fair()

    def weather_until_done(self, weather: Weather) -> float:
        """Other weather until all of the recording has arrived in it."""
        assert self.network is not None
        self.network.change(weather)
        self.robot.wait_done(PATIENCE_S)
        return self.fair()

    def fair(self) -> float:
        """Fair weather again."""
        assert self.network is not None
        self.network.change(FAIR)
        return time.monotonic()

    def kill_robot(self, agent: str) -> float:
        """Kill -9 the robot; it is started again and goes on with the rest."""
        self.robot.kill()
        ended = time.monotonic()
        self.wait(_RESTART_S)
        first = len(self.robot.sent)
        self.start_robot(agent, "--rate", str(RATE), "--first", str(first))
        self.robot.wait_open(PATIENCE_S)
        return ended

    def freeze_robot(self, seconds: float) -> float:
        """Freeze the robot for a while."""
        self.robot.signal(signal.SIGSTOP)
        self.wait(seconds)
        self.robot.signal(signal.SIGCONT)
        return time.monotonic()

    def fill_disk(self, folder: Path, seconds: float) -> float:
        """Take the last byte of a disk for a while."""
        filler = folder / "filler"
        with filler.open("wb", buffering=0) as file:
            for size in (1 << 20, 1 << 12, 1):
                fill(file.write, bytes(size))
        self.wait(seconds)
        filler.unlink()
        return time.monotonic()

    def add_twofold_worker(self) -> None:
        """Another loop solver, whose outcomes all come twice."""
        argv = [sys.executable, "-m", "benchmarks.drill.twice", "--id", "loop_solver-twice"]
        argv += ["--config", str(self.server.config_file), "--data", str(self.data)]
        with (self.folder / "twice.log").open("ab") as log:
            self._helpers.append(
                subprocess.Popen(
                    argv,
                    cwd=CHECKOUT,
                    env=child_environment(),
                    stderr=log,
                    preexec_fn=die_with_parent,
                )
            )
        self.server.instances.add("loop_solver-twice")


def fill(write: object, block: bytes) -> None:
    """Write a block again and again until the disk takes no more."""
    assert callable(write)
    try:
        while write(block) == len(block):
            pass
    except OSError:
        return


def mount_small_disk(folder: Path, megabytes: float) -> None:
    """Mount a disk in memory that is soon full; see `network.own_mounts`."""
    folder.mkdir()
    size = f"size={int(megabytes * 1024)}k"
    argv: Sequence[str] = ("mount", "-t", "tmpfs", "-o", size, "tmpfs", str(folder))
    subprocess.run(argv, check=True)
