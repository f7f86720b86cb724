"""What a seed stands for: the fleet, the weather on the links, and what befalls which process."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace

from tests.simulation.network import Weather

# Faults happen in this time, then everything is mended. [s]
FAULTS_S = 40.0
SERVICES = ("ingest", "place_recognition", "optimizer")
NUM_WORKERS = 2


@dataclass(frozen=True, slots=True)
class Incident:
    """Something that happens to a process or to the router.

    Attributes:
        at_s: When.
        kind: kill, power_cut, kill_at_write, power_cut_at_write, hang, cut_off, disk_full,
            disk_lost, rolled_back, clock_jump, router.
        target: Process; "server" is all of them but the robots; empty for the router.
        lasts_s: How long, or until the process is started again.
        amount: Writes until a kill at a write; seconds of a clock jump; age of a backup in seconds.
    """

    at_s: float
    kind: str
    target: str
    lasts_s: float
    amount: int = 0

    def __str__(self) -> str:
        """One line of a schedule."""
        amount = f" ({self.amount})" if self.amount else ""
        return f"{self.at_s:7.3f} s  {self.kind}{amount} {self.target} for {self.lasts_s:.2f} s"


@dataclass(frozen=True, slots=True)
class Plan:
    """A whole run.

    Attributes:
        seed: Of everything that is drawn while it runs.
        num_robots: Robots of the fleet.
        num_keyframes: Keyframes that each sends.
        period_s: Mean time between two.
        resets: Share of keyframes before which the odometry starts anew.
        neighbours: Rule for rigs.
        solving_s: What a job takes, more or less.
        optimisation_s: What the optimisation of one map takes.
        max_spool_bytes: Limit of the spools, if not the usual one.
        has_poison: One of the jobs kills every worker that takes it.
        ends_with_router: The router is restarted when all is mended, so that every robot asks
            for its latest correction.
        weather: Of the links while there are faults.
        incidents: In order of time.
    """

    seed: int
    num_robots: int
    num_keyframes: int
    period_s: float
    resets: float
    neighbours: str
    solving_s: float
    optimisation_s: float
    max_spool_bytes: int | None
    has_poison: bool
    ends_with_router: bool
    weather: Weather
    incidents: tuple[Incident, ...]

    def __str__(self) -> str:
        """The schedule, for people."""
        lines = [
            f"seed {self.seed}: {self.num_robots} robots x {self.num_keyframes} keyframes every "
            f"{self.period_s:.2f} s, resets {self.resets:g}, rigs by {self.neighbours}, solving "
            f"{self.solving_s:g} s, optimising {self.optimisation_s:g} s, spool "
            f"{self.max_spool_bytes or 'unlimited'}{', a poison job' if self.has_poison else ''}",
            f"  until {FAULTS_S:g} s: {self.weather}",
            *(f"  {incident}" for incident in self.incidents),
        ]
        if self.ends_with_router:
            lines.append(f"  {FAULTS_S:7.3f} s  router restarted")
        return "\n".join(lines)

    def without(self, number: int) -> Plan:
        """The same with one incident less."""
        rest = self.incidents[:number] + self.incidents[number + 1 :]
        return replace(self, incidents=rest)


def processes(num_robots: int) -> list[str]:
    """Names of all processes."""
    workers = [f"worker{i}" for i in range(NUM_WORKERS)]
    return [*SERVICES, *workers, *(f"robot{i}" for i in range(num_robots))]


def draw_plan(seed: int) -> Plan:
    """The plan of a seed."""
    draw = random.Random(f"plan {seed}")
    num_robots = draw.choice([1, 2, 2, 3])
    weather = Weather(
        loss=draw.choice([0.0, 0.0, 0.02, 0.1, 0.3]),
        repeats=draw.choice([0.0, 0.05, 0.3]),
        lag=draw.choice([0.0, 0.1, 0.4]),
        max_lag_s=draw.choice([0.1, 2.0, 15.0]),
    )
    count = draw.choice([0, 1, 2, 3, 5, 8, 12])
    incidents = sorted(
        (_incident(draw, num_robots) for _ in range(count)), key=lambda one: one.at_s
    )
    return Plan(
        seed=seed,
        num_robots=num_robots,
        num_keyframes=draw.randint(6, 10),
        period_s=draw.choice([0.2, 1.0, 3.0]),
        resets=draw.choice([0.0, 0.0, 0.2]),
        neighbours=draw.choice(["index", "index", "geometry"]),
        solving_s=draw.choice([0.1, 0.5, 4.0]),
        optimisation_s=draw.choice([0.0, 0.3, 3.0]),
        max_spool_bytes=draw.choice([None, None, 4000]),
        has_poison=draw.random() < 0.15,
        ends_with_router=draw.random() < 0.5,
        weather=weather,
        incidents=tuple(incidents),
    )


def _incident(draw: random.Random, num_robots: int) -> Incident:
    names = processes(num_robots)
    kind = draw.choice(
        [
            *["kill", "power_cut", "kill_at_write", "power_cut_at_write"] * 2,
            *["kill_at_write", "power_cut_at_write", "power_cut_of_all", "disk_lost"],
            "rolled_back",
            *[
                "hang",
                "hang",
                "cut_off",
                "cut_off",
                "disk_full",
                "clock_jump",
                "router",
                "disk_lost",
            ],
        ]
    )
    at_s = round(draw.uniform(0.0, FAULTS_S), 3)
    lasts_s = draw.choice([0.05, 0.5, 2.0, 8.0, 20.0]) * draw.uniform(0.5, 1.0)
    if kind == "hang" and draw.random() < 0.2:
        lasts_s = 75.0  # longer than a lease
    if kind == "power_cut_of_all":
        return Incident(at_s, "power_cut", "server", lasts_s)
    if kind == "disk_lost":  # of ingest: then there is a new log
        target = draw.choice(["ingest", "ingest", "place_recognition", "optimizer"])
        return Incident(at_s, kind, target, lasts_s)
    if kind == "rolled_back":  # one file comes from a backup that is older than the others
        target = draw.choice(SERVICES)
        return Incident(at_s, kind, target, lasts_s, draw.choice([1, 3, 10]))
    if kind == "router":
        return Incident(at_s, kind, "", min(lasts_s, 5.0))
    if kind == "clock_jump":
        return Incident(at_s, kind, draw.choice(names), 0.0, draw.choice([-86400, -60, 60, 86400]))
    if kind.endswith("at_write") or kind == "disk_full":
        with_disk = [*SERVICES, *(name for name in names if name.startswith("robot"))]
        amount = draw.randint(1, 25) if kind.endswith("at_write") else 0
        return Incident(at_s, kind, draw.choice(with_disk), lasts_s, amount)
    return Incident(at_s, kind, draw.choice(names), lasts_s)
