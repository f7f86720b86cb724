"""The cases of the drill: what breaks in each, on what it plays, and how soon all is well again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from benchmarks.drill.link import Weather
from benchmarks.drill.stage import RATE, Stage

CLEAN = "clean"
STREAMING = "agent1"
# Keyframes of the streaming robot before anything breaks.
_BEFORE = 12
WORKERS = ("loop_solver-0", "loop_solver-1")
_SOON_S = 5.0
_HUNG_S = 15.0
# After a loss that TCP hardly gets through: for every keyframe that waits. [s]
DRAIN_S = 0.1
_OUTAGE = Weather(down=True)


@dataclass(frozen=True, slots=True)
class Case:
    """One case.

    Attributes:
        title: What breaks, for the table.
        fault: Makes it, while a robot is on its way, and returns when the cause ended [s of the
            monotonic clock]; see `Stage`.
        transport: ``tls`` or ``quic``: robots and server on two sides of a link; None: all on
            this machine, without credentials.
        recovery_s: All is well again so long after the cause, or the case has failed; None where
            nothing has to recover.
        drain_s: And so much more for every keyframe that waits then.
        before: Keyframes of the streaming robot before the fault.
        rate: Keyframes per second of the streaming robot.
        robot: Its module.
        options: Further arguments of it.
        twofold: Whether there is a worker whose outcomes all come twice.
        server_disk_mb: Size of the server's disk; None: large.
        robot_disk_mb: Size of the robots' disk.
    """

    title: str
    fault: Callable[[Stage], float]
    transport: str | None = None
    recovery_s: float | None = _SOON_S
    drain_s: float = 0.0
    before: int = _BEFORE
    rate: float = RATE
    robot: str = "benchmarks.drill.robot"
    options: tuple[str, ...] = ()
    twofold: bool = False
    server_disk_mb: float | None = None
    robot_disk_mb: float | None = None

    @property
    def has_small_disk(self) -> bool:
        """Whether a disk has to be mounted."""
        return self.server_disk_mb is not None or self.robot_disk_mb is not None


def cases() -> Mapping[str, Case]:
    """All cases by name; `clean` is what the others are compared with."""
    undisturbed = {CLEAN: Case("nothing", Stage.nothing, recovery_s=None)}
    return undisturbed | _processes() | _robots() | _messages() | _disks() | _links()


def _processes() -> dict[str, Case]:
    victims = {
        "router": ("router",),
        "ingest": ("ingest",),
        "place_recognition": ("place_recognition",),
        "worker": WORKERS[:1],
        "all_workers": WORKERS,
        "optimizer": ("optimizer",),
    }
    made = {}
    for name, processes in victims.items():
        who = name.replace("_", " ")
        made[f"kill_{name}"] = Case(f"`kill -9`: {who}", _kill(processes))
        made[f"hang_{name}"] = Case(f"hang for ever: {who}", _hang(processes), recovery_s=_HUNG_S)
    return made


def _kill(names: tuple[str, ...]) -> Callable[[Stage], float]:
    return lambda stage: stage.kill(*names)


def _hang(names: tuple[str, ...]) -> Callable[[Stage], float]:
    return lambda stage: stage.hang(*names)


def _robots() -> dict[str, Case]:
    return {
        "kill_agent": Case(
            "`kill -9`: a robot, started again after 1 s", lambda s: s.kill_robot(STREAMING)
        ),
        "hang_agent": Case(
            "hang: a robot for 8 s", lambda s: s.freeze_robot(8.0), recovery_s=_HUNG_S
        ),
        "odometry_reset": Case(
            "a robot's odometry begins anew",
            Stage.nothing,
            recovery_s=None,
            options=("--reset-at", "28"),
        ),
    }


def _messages() -> dict[str, Case]:
    return {
        "uploads_twice_and_reordered": Case(
            "every upload twice, out of order",
            Stage.nothing,
            recovery_s=None,
            robot="benchmarks.drill.careless",
        ),
        "outcomes_twice": Case(
            "two workers return the same job", Stage.nothing, recovery_s=None, twofold=True
        ),
    }


def _disks() -> dict[str, Case]:
    return {
        "disk_full_agent": Case(
            "a robot's disk is full for 6 s",
            lambda s: s.fill_disk(s.spools, 6.0),
            robot_disk_mb=16.0,
        ),
        "disk_full_server": Case(
            "the server's disk is full for 6 s",
            lambda s: s.fill_disk(s.data, 6.0),
            server_disk_mb=64.0,
        ),
    }


def _links() -> dict[str, Case]:
    made = {}
    for transport, called in (("tls", "TCP"), ("quic", "QUIC")):
        for percent in (5, 10, 30):
            made[f"loss_{percent}_{transport}"] = _loss(percent, transport, called)
        for seconds in (3, 15):
            made[f"outage_{seconds}s_{transport}"] = Case(
                f"link down for {seconds} s, {called}",
                _weather(_OUTAGE, seconds),
                transport,
            )
        made[f"cap_2mbit_{transport}"] = Case(
            f"2 Mbit/s for 10 s, 3 offered, {called}",
            _weather(Weather(mbit_per_s=2.0), 10.0),
            transport,
            rate=10.0,
            before=6,
        )
        made[f"packets_twice_and_reordered_{transport}"] = Case(
            f"10 % of the packets twice, 20 % late for 8 s, {called}",
            _weather(Weather(repeats=0.1, late=0.2), 8.0),
            transport,
        )
    return made


def _loss(percent: int, transport: str, called: str) -> Case:
    weather = Weather(loss=percent / 100)
    if transport == "quic":  # all of it arrives in the rain
        title = f"{percent} % loss to the end, {called}"
        return Case(title, lambda s: s.weather_until_done(weather), transport)
    drain_s = DRAIN_S if percent > 10 else 0.0
    title = f"{percent} % loss for 10 s, {called}"
    return Case(title, _weather(weather, 10.0), transport, drain_s=drain_s)


def _weather(weather: Weather, seconds: float) -> Callable[[Stage], float]:
    return lambda stage: stage.weather(weather, seconds)
