"""Jobs of a recorded log with real processes: the same whoever solves them and whoever dies."""

from __future__ import annotations

import dataclasses
import math
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml
from covinz_agents.rendered import RenderedRobot
from covinz_agents.selection import select_keyframes

from covinz import client, codec, keyexprs
from covinz.bus import Bus, ZenohBus
from covinz.config import BusConfig, Config, load
from covinz.keyframes import RemoteKeyframeStore
from covinz.scenario import RenderedAgent, Scenario
from covinz.types import (
    JobDone,
    JobRecord,
    JobState,
    Keyframe,
    KeyframeId,
    Lease,
    LeaseRequest,
    LogEntry,
    LoopClosure,
    Outcome,
    Status,
)
from services.loop_solver.solver import LoopSolver
from services.place_recognition.service import recognizer_factory
from tests.small_world import CAMERA, SCENE, arc

pytestmark = pytest.mark.slow

PATIENCE_S = 120.0
NUM_KEYFRAMES = 12
# A smaller paper profile, so that a job takes a tenth of a second.
SETTINGS: dict[str, dict[str, object]] = {
    "place_recognition": {"num_candidates": 2, "min_loop_keyframes": 6, "min_loop_s": 0.0},
    "loop_solver": {"profile": "paper", "max_rig_iterations": 300, "num_covariance_samples": 10},
}

StartProcess = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def config_file(tmp_path: Path, bus_config: BusConfig) -> Path:
    """The endpoint of this test and settings for short jobs."""
    path = tmp_path / "config.yaml"
    settings = {"bus": bus_config.model_dump(mode="json"), **SETTINGS}
    path.write_text(yaml.safe_dump(settings))
    return path


@dataclass(frozen=True)
class System:
    """Router, ingest with a recorded log, and whatever a test starts."""

    start: StartProcess
    bus: Bus
    config: Config
    data: Path
    router: subprocess.Popen[str]

    def status(self, name: str, instance: str | None = None) -> Status | None:
        for status in client.statuses(self.bus, name):
            if instance in (None, status.instance):
                return status
        return None

    def until(self, what: str, holds: Callable[[], bool]) -> None:
        """Wait for a state that processes only tell when asked."""
        deadline = time.monotonic() + PATIENCE_S
        pause = threading.Event()
        while not holds():
            assert time.monotonic() < deadline, f"timed out: {what}"
            pause.wait(0.02)

    def place_recognition_at_head(self, head: int) -> None:
        def holds() -> bool:
            status = self.status("place_recognition")
            return status is not None and status.cursor == head

        self.until("place recognition has read the log", holds)

    def all_jobs_done(self, head: int) -> list[JobRecord]:
        def holds() -> bool:
            status = self.status("place_recognition")
            return status is not None and (status.cursor, status.pending, status.leased) == (
                head,
                0,
                0,
            )

        self.until("all jobs are done", holds)
        return list(client.jobs(self.bus))

    def forget_jobs(self) -> None:
        for file in self.data.glob("place_recognition.sqlite*"):
            file.unlink()


def rendered_keyframes() -> list[tuple[RenderedRobot, Keyframe]]:
    """Two robots on one way, one behind the other, in stamp order."""
    entries = [
        {
            "id": f"agent{number}",
            "reader": "rendered",
            "camera": CAMERA,
            "path": arc(0.15 * number, math.pi, 2.0 * number),
            "keyframes": {"translation_m": 0.3, "rotation_rad": 0.25},
        }
        for number in range(2)
    ]
    scenario = Scenario.model_validate({"name": "small", "scene": SCENE, "agents": entries})
    made = []
    for number, agent in enumerate(scenario.agents):
        assert isinstance(agent, RenderedAgent)
        robot = RenderedRobot(agent, scenario)
        session = f"01ARZ3NDEKTSV4RRFFQ69G5FA{number}"
        chosen = select_keyframes(robot.frames, agent.keyframes)[:NUM_KEYFRAMES]
        for seq, frame in enumerate(chosen):
            kf_id = KeyframeId(agent.id, session, seq)
            features = robot.features(frame)
            kf = Keyframe(kf_id, frame.stamp_ns, frame.T_odom_body, robot.camera.hash, features)
            made.append((robot, kf))
    return sorted(made, key=lambda one: (one[1].stamp_ns, one[1].id))


@pytest.fixture(scope="module")
def recording() -> list[tuple[RenderedRobot, Keyframe]]:
    return rendered_keyframes()


@pytest.fixture
def system(
    tmp_path: Path,
    config_file: Path,
    start_service: StartProcess,
    open_bus: Callable[[], ZenohBus],
    recording: list[tuple[RenderedRobot, Keyframe]],
) -> Iterator[System]:
    """The log holds the recording; place recognition is not started."""
    router = start_service("router")
    start_service("ingest")
    bus = open_bus()
    assert bus.wait_connected(PATIENCE_S)
    system = System(start_service, bus, load(config_file, {}), tmp_path / "data", router)
    system.until("ingest is up", lambda: system.status("ingest") is not None)
    for robot, kf in recording:
        camera = codec.encode(robot.camera)
        upload(bus, keyexprs.agent_camera(kf.id.agent), camera)
        upload(bus, keyexprs.agent_keyframe(kf.id.agent), codec.encode(kf))
    yield system


def upload(bus: Bus, key: str, payload: bytes) -> None:
    (reply,) = bus.ask(key, payload)
    codec.decode_upload_reply(reply)


def job_list(records: list[JobRecord]) -> list[bytes]:
    return [codec.encode(record.job) for record in records]


def outcomes(records: list[JobRecord]) -> list[bytes]:
    """Outcomes bit by bit, without the time they took."""
    found = []
    for record in records:
        assert record.outcome is not None
        found.append(codec.encode(dataclasses.replace(record.outcome, solver_ms=0.0)))
    return found


def expected_jobs(config: Config, recording: list[tuple[RenderedRobot, Keyframe]]) -> list[bytes]:
    """The job list that the log implies, made without any process."""
    cameras = {robot.camera.hash: robot.camera for robot, _ in recording}
    recognizer = recognizer_factory(config, cameras.get)()
    entries = [LogEntry(i, over_the_wire(kf)) for i, (_, kf) in enumerate(recording)]
    return [codec.encode(job) for entry in entries for job in recognizer.process(entry)]


def over_the_wire(kf: Keyframe) -> Keyframe:
    return codec.decode(codec.encode(kf), Keyframe)


def expected_outcomes(system: System, records: list[JobRecord]) -> list[bytes]:
    """Every job solved once more, here and now."""
    solver = LoopSolver(system.config.loop_solver, RemoteKeyframeStore(system.bus, 1024))
    again = [dataclasses.replace(r, outcome=solver.solve(r.job)) for r in records]
    return outcomes(again)


def solve_in_disorder(system: System, hands: int) -> None:
    """Be a crowd of workers: hold several leases, bring outcomes back shuffled, some twice."""
    rng = np.random.default_rng(11)
    solver = LoopSolver(system.config.loop_solver, RemoteKeyframeStore(system.bus, 1024))
    while True:
        held: list[Outcome] = []
        for hand in range(hands):
            status = system.status("place_recognition")
            assert status is not None
            if status.pending == 0:
                break
            request = codec.encode(LeaseRequest(f"hand-{hand}"))
            (reply,) = system.bus.ask(keyexprs.JOB_LEASE, request)
            held.append(solver.solve(codec.decode(reply, Lease).job))
        if not held:
            return
        for i in rng.permutation(len(held)):
            if isinstance(held[i], LoopClosure):
                upload(system.bus, keyexprs.LOOP, codec.encode(held[i]))
            done = codec.encode(JobDone(f"hand-{i}", held[i]))
            for _ in range(1 + int(rng.integers(2))):
                upload(system.bus, keyexprs.JOB_DONE, done)


def test_one_worker_three_workers_and_disorder_agree(
    system: System, recording: list[tuple[RenderedRobot, Keyframe]]
) -> None:
    head = len(recording)
    system.start("optimizer")

    desk = system.start("place_recognition")
    worker = system.start("loop_solver", "worker-0")
    one = system.all_jobs_done(head)
    stop(worker)
    stop(desk)

    system.forget_jobs()
    desk = system.start("place_recognition")
    workers = [system.start("loop_solver", f"worker-{i}") for i in range(3)]
    three = system.all_jobs_done(head)
    for worker in workers:
        stop(worker)
    stop(desk)

    system.forget_jobs()
    system.start("place_recognition")
    system.place_recognition_at_head(head)
    solve_in_disorder(system, hands=6)
    disorder = system.all_jobs_done(head)

    assert job_list(one) == expected_jobs(system.config, recording)
    assert job_list(one) == job_list(three) == job_list(disorder)
    assert outcomes(one) == outcomes(three) == outcomes(disorder)
    accepted = [r for r in one if isinstance(r.outcome, LoopClosure)]
    assert len(accepted) >= 5
    assert {(r.job.query.agent, r.job.cand.agent) for r in accepted} >= {("agent1", "agent0")}


def test_a_worker_killed_in_the_middle_of_a_job(
    system: System, recording: list[tuple[RenderedRobot, Keyframe]]
) -> None:
    system.start("optimizer")
    system.start("place_recognition")
    system.place_recognition_at_head(len(recording))
    lost = kill_in_a_job(system, system.start("loop_solver", "worker-0"))
    system.start("loop_solver", "worker-1")
    records = system.all_jobs_done(len(recording))
    assert all(record.state is JobState.DONE for record in records)
    attempts = {record.job.id: record.attempts for record in records}
    assert attempts.pop(lost) == 2
    assert set(attempts.values()) == {1}
    assert job_list(records) == expected_jobs(system.config, recording)
    assert outcomes(records) == expected_outcomes(system, records)


def test_place_recognition_killed_at_work(
    system: System, recording: list[tuple[RenderedRobot, Keyframe]]
) -> None:
    system.start("optimizer")
    for i in range(2):
        system.start("loop_solver", f"worker-{i}")
    durable: list[JobRecord] = []
    for kills in range(1, 4):
        desk = system.start("place_recognition")

        def is_under_way(kills: int = kills) -> bool:
            status = system.status("place_recognition")
            done = 0 if status is None else num_outcomes(status)
            return done >= 3 * kills

        system.until("some jobs are done", is_under_way)
        known = [r for r in client.jobs(system.bus) if r.outcome is not None]
        assert len(known) >= len(durable)
        durable = known
        desk.kill()
        desk.wait()
    system.start("place_recognition")
    records = system.all_jobs_done(len(recording))
    assert job_list(records) == expected_jobs(system.config, recording)
    assert outcomes(records) == expected_outcomes(system, records)
    # What was known before a crash was not solved again: even its time is the same.
    after = {r.job.id: codec.encode(r.outcome) for r in records}
    assert all(after[r.job.id] == codec.encode(r.outcome) for r in durable)


def test_sigterm_ends_processes_cleanly(
    system: System, recording: list[tuple[RenderedRobot, Keyframe]]
) -> None:
    system.start("optimizer")
    idle = system.start("loop_solver", "idle")
    system.until("the worker is up", lambda: system.status("loop_solver", "idle") is not None)
    # Nobody lends jobs, then somebody holds the request open: it ends in both cases.
    assert stop(idle) == 0
    desk = system.start("place_recognition")
    busy = system.start("loop_solver", "busy")

    def is_busy() -> bool:
        status = system.status("loop_solver", "busy")
        return status is not None and status.leased == 1

    system.until("a job is at work", is_busy)
    assert stop(busy) == 0
    # It finished its job, or gave it back: nothing is lent out any more.
    system.until("no lease is left", lambda: leases(system) == 0)
    system.start("loop_solver", "successor")
    records = system.all_jobs_done(len(recording))
    assert job_list(records) == expected_jobs(system.config, recording)
    last = system.start("loop_solver", "waiting")
    system.until("the worker is up", lambda: system.status("loop_solver", "waiting") is not None)
    assert stop(last) == 0
    assert stop(desk) == 0


def kill_in_a_job(system: System, worker: subprocess.Popen[str]) -> str:
    """Kill a worker while it holds a job; returns the job's id."""
    held = freeze_in_a_job(system, worker)
    worker.kill()
    worker.wait()
    return held


def freeze_in_a_job(system: System, worker: subprocess.Popen[str]) -> str:
    """Freeze a worker while it holds a job; returns the job's id."""
    while True:
        system.until("a job is lent", lambda: leases(system) == 1)
        # Frozen, it cannot finish between the looks.
        worker.send_signal(signal.SIGSTOP)
        held = [r.job.id for r in client.jobs(system.bus) if r.state is JobState.LEASED]
        if held and leases(system) == 1:
            return held[0]
        worker.send_signal(signal.SIGCONT)


def leases(system: System) -> int:
    status = system.status("place_recognition")
    return 0 if status is None else status.leased


def num_outcomes(status: Status) -> int:
    return int(
        sum(
            n
            for name, n in status.counters.items()
            if name.split(".")[0] in ("accepted", "rejected")
        )
    )


def stop(process: subprocess.Popen[str]) -> int:
    process.send_signal(signal.SIGTERM)
    return process.wait(PATIENCE_S)
