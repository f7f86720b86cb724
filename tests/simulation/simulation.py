"""One seed, from the plan to the verdict: all processes, their faults, and what must hold."""

from __future__ import annotations

import functools
import hashlib
import logging
import random
import shutil
import tempfile
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from covinz import client, codec, keyexprs
from covinz.bus import Bus
from covinz.config import OptimizerConfig
from covinz.service import Context, serve_on
from covinz.types import Lease, LoopJob
from services.ingest import service as ingest
from services.loop_solver import service as loop_solver
from services.optimizer import service as optimizer
from services.optimizer.components import Component
from services.optimizer.optimisation import MapEstimate, optimise
from services.place_recognition import service as place_recognition
from tests.simulation import world
from tests.simulation.disk import Layer
from tests.simulation.machine import SimulatedMachine
from tests.simulation.network import CALM, QUERY_TIMEOUT_S, Network, SimulatedBus
from tests.simulation.plan import FAULTS_S, NUM_WORKERS, SERVICES, Incident, Plan
from tests.simulation.process import Main, Process, Wrap
from tests.simulation.robot import Robot
from tests.simulation.scheduler import Killed, Scheduler
from tests.simulation.verdict import Evidence, collect, contents, faults_of

# After the last fault the system is idle within this. [s]
RECOVERY_S = 400.0
# Nobody looks before the last fault is so long ago. [s]
CALM_S = 3.0
# Lines of the trace that are kept for people.
TRACE_LINES = 60

Run = Callable[[Context], None]


@dataclass(frozen=True, slots=True)
class Sabotage:
    """Defects that are put in on purpose, to see that they are found.

    Attributes:
        wrap: Puts something between a process and its bus.
        runs: Services with a defect, in the place of the real ones, by name.
        lying_disks: Processes whose disks say that they have synced and have not.
    """

    wrap: Wrap = lambda _, bus: bus
    runs: Mapping[str, Run] = field(default_factory=dict)
    lying_disks: tuple[str, ...] = ()


NONE = Sabotage()


@dataclass(frozen=True, slots=True)
class Report:
    """What came of a seed.

    Attributes:
        plan: What was played.
        failure: What did not hold; None when all did.
        digest: Of everything that happened in this run.
        virtual_s: How long it took in the simulation.
        steps: Times that a thread was resumed.
        trace: The last messages.
        counts: What happened how often.
    """

    plan: Plan
    failure: str | None
    digest: str
    virtual_s: float
    steps: int
    trace: tuple[str, ...]
    counts: Mapping[str, int]

    def __str__(self) -> str:
        """Schedule, the end of the trace, and what failed."""
        return "\n".join([str(self.plan), *self.trace, f"FAILED {self.failure}"])


def simulate(plan: Plan, sabotage: Sabotage = NONE, trace_lines: int = TRACE_LINES) -> Report:
    """Play a plan and judge it."""
    folder = Path(tempfile.mkdtemp(prefix="covinz-simulation-")).resolve()
    try:
        with LAYER.installed(), _quiet() as complaints:
            return Simulation(plan, sabotage, folder, trace_lines).play(complaints)
    finally:
        LAYER.disks.clear()
        shutil.rmtree(folder)


LAYER = Layer()


class Simulation:
    """The whole system in one program."""

    def __init__(self, plan: Plan, sabotage: Sabotage, folder: Path, trace_lines: int) -> None:
        self._plan = plan
        self._sabotage = sabotage
        self._scheduler = Scheduler(random.Random(f"schedule {plan.seed}"))
        self._network = Network(self._scheduler, random.Random(f"network {plan.seed}"))
        self._network.trace = self._note
        self._network.on_answer = self._see_answer
        self._config = world.configuration(plan.neighbours, plan.max_spool_bytes)
        self._robots = [Robot(i, plan, self._config) for i in range(plan.num_robots)]
        self._digest = hashlib.blake2b(digest_size=8)
        self._trace: deque[str] = deque(maxlen=trace_lines)
        self._counts: Counter[str] = Counter()
        self._evidence: Evidence | None = None
        ends = [one.at_s + one.lasts_s for one in plan.incidents]
        self._calm_s = max([FAULTS_S, *ends])
        # What was sent before all was mended may still be on its way, and who asked then and was
        # not heard asks again.
        last_s = max(self._calm_s, FAULTS_S + plan.weather.max_lag_s)
        self._look_s = last_s + QUERY_TIMEOUT_S + CALM_S
        self._job_of: dict[str, str] = {}
        self._poison = ""
        # How often a worker was really lost with a job in hand, or hung for too long.
        self._losses: Counter[str] = Counter()
        self._processes = {
            name: Process(
                name,
                plan.seed,
                main,
                self._scheduler,
                self._network,
                LAYER,
                folder,
                sabotage.wrap,
            )
            for name, main in self._mains().items()
        }

    def play(self, complaints: list[str]) -> Report:
        """Run it to its end."""
        for process in self._processes.values():
            process.has_lying_disk = process.name in self._sabotage.lying_disks
            process.start()
        for incident in self._plan.incidents:
            self._scheduler.at(incident.at_s, functools.partial(self._befall, incident))
            if incident.kind == "rolled_back":
                backup_s = max(0.0, incident.at_s - incident.amount)
                self._scheduler.at(backup_s, self._processes[incident.target].back_up)
        self._network.weather = self._plan.weather
        self._scheduler.at(FAULTS_S, self._mend)
        if self._plan.ends_with_router:
            self._scheduler.at(self._calm_s, functools.partial(self._restart_router, 1.0))
        limit_s = self._calm_s + RECOVERY_S
        in_time = self._scheduler.run(lambda: self._evidence is not None, limit_s)
        failure = self._scheduler.failure
        if failure is None and not in_time:
            failure = f"not idle after {limit_s:.0f} s: {self._state()}"
        for process in self._processes.values():
            process.end_for_ever()
        self._scheduler.finish()
        if failure is None and self._evidence is not None:
            failure = self._judge(self._evidence)
        if failure is not None and complaints:
            failure += "\n" + "\n".join(complaints[-5:])
        return Report(
            self._plan,
            failure,
            self._digest.hexdigest(),
            self._scheduler.now_s,
            self._scheduler.steps,
            tuple(self._trace),
            dict(self._counts),
        )

    # --- processes -----------------------------------------------------------------------------

    def _mains(self) -> dict[str, Main]:
        runs: dict[str, Run] = {
            "ingest": ingest.run,
            "place_recognition": place_recognition.run,
            "optimizer": self._optimise_in,
            **self._sabotage.runs,
        }
        mains: dict[str, Main] = {
            name: functools.partial(self._serve, name, runs[name]) for name in SERVICES
        }
        for i in range(NUM_WORKERS):
            name = f"worker{i}"
            solve = functools.partial(self._solve_in, name)
            mains[name] = functools.partial(self._serve, "loop_solver", solve)
        mains.update({robot.name: robot.main for robot in self._robots})
        mains["operator"] = self._operate
        return mains

    def _serve(self, name: str, run: Run, machine: SimulatedMachine, bus: Bus, folder: Path) -> int:
        return serve_on(
            bus, name, machine.name, self._config, folder, run, lambda *_: None, machine
        )

    def _solve_in(self, name: str, context: Context) -> None:
        work = functools.partial(self._work, name)
        loop_solver.run(context, lambda config, store: world.TruthfulSolver(config, store, work))

    def _optimise_in(self, context: Context) -> None:
        """Optimisations take time, so that things happen meanwhile."""
        machine = context.machine
        assert isinstance(machine, SimulatedMachine)

        def slowly(component: Component, config: OptimizerConfig) -> MapEstimate:
            machine.sleep(self._plan.optimisation_s)
            return optimise(component, config)

        optimizer.run(context, slowly)

    def _work(self, name: str, job: LoopJob) -> None:
        """The time that a job takes, or the end of the process that touches it."""
        process = self._processes[name]
        if self._plan.has_poison and not self._poison:
            self._poison = job.id
        if job.id == self._poison:
            self._lose_job(name)
            process.kill(restart_s=0.5)
            raise Killed
        process.machine.sleep(self._plan.solving_s * (0.5 + int(job.id[:4], 16) / 65536))

    def _operate(self, machine: SimulatedMachine, bus: Bus, _: Path) -> int:
        """Ask until everything is idle twice in a row, then collect what there is."""
        times = 0
        while times < 2:
            machine.sleep(1.0)
            is_idle = (
                self._scheduler.now_s > self._look_s
                and all(robot.is_done for robot in self._robots)
                and all(process.is_running for process in self._processes.values())
                and client.progress(bus).idle
            )
            times = times + 1 if is_idle else 0
        self._evidence = collect(bus, self._robots)
        machine.sleep(1000.0)
        return 0

    # --- faults --------------------------------------------------------------------------------

    def _befall(self, incident: Incident) -> None:
        lasts_s = incident.lasts_s
        if incident.kind == "router":
            self._restart_router(lasts_s)
            return
        if incident.target == "server":
            self._lose_all_jobs()
            for name, process in self._processes.items():
                if not name.startswith(("robot", "operator")):
                    process.kill(lasts_s, is_power_cut=True)
            return
        process = self._processes[incident.target]
        match incident.kind:
            case "kill" | "power_cut":
                self._lose_job(process.name)
                process.kill(lasts_s, incident.kind == "power_cut")
            case "kill_at_write" | "power_cut_at_write":
                is_power_cut = incident.kind.startswith("power_cut")
                process.kill_at_write(incident.amount, lasts_s, is_power_cut)
            case "hang":
                if lasts_s > self._config.place_recognition.lease_s / 2:
                    self._lose_job(process.name)
                process.hang(lasts_s)
            case "cut_off":
                process.cut_off(lasts_s)
            case "disk_lost":
                self._lose_log(process.name)
                process.lose_disk(lasts_s)
            case "rolled_back":
                self._lose_log(process.name)
                process.roll_back(lasts_s)
            case "disk_full":
                process.fill_disk(lasts_s)
            case "clock_jump":
                process.set_clock(incident.amount)

    def _lose_log(self, name: str) -> None:
        if name == "ingest":
            for robot in self._robots:
                robot.log_is_lost()

    def _restart_router(self, down_s: float) -> None:
        self._note("dies", "router", "")
        self._network.set_router(False)
        self._scheduler.after(down_s, functools.partial(self._network.set_router, True))

    def _mend(self) -> None:
        self._note("all is mended", "", "")
        self._network.weather = CALM
        for process in self._processes.values():
            process.disk.writes_left = None

    def _lose_all_jobs(self) -> None:
        for worker in self._job_of:
            self._lose_job(worker)

    def _lose_job(self, worker: str) -> None:
        if worker in self._job_of:
            self._losses[self._job_of[worker]] += 1

    # --- what is seen --------------------------------------------------------------------------

    def _note(self, what: str, who: str, key: str) -> None:
        line = f"{self._scheduler.now_s:9.4f} {who} {what} {key}"
        self._digest.update(line.encode())
        self._trace.append(line)
        self._counts[what] += 1

    def _see_answer(self, member: SimulatedBus, key: str, payload: bytes) -> None:
        name = member.machine.name
        if codec.says_it_is(payload, Lease):
            self._job_of[name] = codec.decode(payload, Lease).job.id
        elif key == keyexprs.JOB_DONE:
            self._job_of.pop(name, None)

    def _state(self) -> str:
        robots = ", ".join(
            f"{r.name} has {r.agent.pending if r.agent else '?'} uploads left" for r in self._robots
        )
        down = [p.name for p in self._processes.values() if not p.is_running]
        return f"{robots}; not running: {down or 'nobody'}"

    def _judge(self, evidence: Evidence) -> str | None:
        self._counts.update(contents(evidence))
        found = faults_of(
            evidence,
            self._config,
            self._robots,
            self._losses,
            self._poison,
            self._plan.ends_with_router,
        )
        return "\n".join(found) or None


@contextmanager
def _quiet() -> Iterator[list[str]]:
    """Keep the product's log off the terminal; what it says of errors is kept."""
    complaints: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            complaints.append(self.format(record))

    handler = Keep(logging.ERROR)
    loggers = [logging.getLogger(name) for name in ("covinz", "services")]
    before = [(one.level, one.propagate) for one in loggers]
    for one in loggers:
        one.addHandler(handler)
        one.setLevel(logging.ERROR)
        one.propagate = False
    try:
        yield complaints
    finally:
        for one, (level, propagate) in zip(loggers, before, strict=True):
            one.removeHandler(handler)
            one.setLevel(level)
            one.propagate = propagate
