"""Jobs whose workers fail, hang or lose their link, with real processes and a real router."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from covinz_agents.rendered import RenderedRobot

from covinz import client, codec, keyexprs
from covinz.bus import ZenohBus
from covinz.config import BusConfig
from covinz.keyframes import RemoteKeyframeStore
from covinz.saved_job import read_saved_job, saved_job_path
from covinz.types import (
    Duplicate,
    JobDone,
    JobState,
    Keyframe,
    Lease,
    LeaseRequest,
    LoopClosure,
    Outcome,
    Rejection,
    Stored,
    UploadReply,
)
from services.loop_solver.solver import LoopSolver
from tests.system import test_jobs
from tests.system.test_jobs import SETTINGS, System, freeze_in_a_job, outcomes

pytestmark = pytest.mark.slow

recording, system = test_jobs.recording, test_jobs.system
Recording = list[tuple[RenderedRobot, Keyframe]]
# Of the workers that hang; one that only waits is back sooner.
LEASE_S = 8.0
CHECKOUT = Path(__file__).parents[2]


@pytest.fixture
def config_file(tmp_path: Path, bus_config: BusConfig) -> Path:
    """Short jobs and short leases."""
    path = tmp_path / "config.yaml"
    settings = {"bus": bus_config.model_dump(mode="json"), **SETTINGS}
    settings["place_recognition"] = {**SETTINGS["place_recognition"], "lease_s": LEASE_S}
    path.write_text(yaml.safe_dump(settings))
    return path


def covinz(system: System, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    return subprocess.run(
        [sys.executable, "-m", "covinz.cli", *arguments],
        cwd=CHECKOUT,
        env={
            **os.environ,
            "COVINZ__BUS__ENDPOINT": system.config.bus.endpoint,
            "COLUMNS": "200",
        },
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )


def lease(bus: ZenohBus, worker: str) -> Lease:
    replies: list[bytes] = []
    while not replies:
        replies = bus.ask(keyexprs.JOB_LEASE, codec.encode(LeaseRequest(worker)), 10.0)
    return codec.decode(replies[0], Lease)


def bring(bus: ZenohBus, worker: str, lent: Lease, outcome: Outcome) -> UploadReply:
    if isinstance(outcome, LoopClosure):
        bus.ask(keyexprs.LOOP, codec.encode(outcome))
    done = JobDone(worker, outcome, lent.log_id)
    (reply,) = bus.ask(keyexprs.JOB_DONE, codec.encode(done))
    return codec.decode_upload_reply(reply)


def state_of(system: System, job_id: str) -> tuple[JobState, int]:
    (record,) = [r for r in client.jobs(system.bus) if r.job.id == job_id]
    return record.state, record.attempts


def is_leased_once(system: System, job_id: str) -> bool:
    try:
        return state_of(system, job_id) == (JobState.LEASED, 1)
    except client.ServerUnavailable:
        return False


def kill_a_worker(system: System, bus: ZenohBus, worker: str) -> str:
    """Lets a worker vanish with the first job it gets; returns the job once it is taken back."""
    token = bus.declare_alive(keyexprs.worker_alive(worker))
    job_id = lease(bus, worker).job.id
    token.close()
    system.until("it is taken back", lambda: state_of(system, job_id)[0] is not JobState.LEASED)
    return job_id


def is_over(system: System) -> bool:
    status = system.status("place_recognition")
    return status is not None and (status.pending, status.leased) == (0, 0)


def test_a_job_that_kills_its_workers_is_saved_and_can_be_tried_again(
    system: System, recording: Recording, open_bus: Callable[[], ZenohBus]
) -> None:
    system.start("optimizer")
    system.start("place_recognition")
    system.place_recognition_at_head(len(recording))
    bus = open_bus()
    assert bus.wait_connected(10.0)
    (poison,) = {kill_a_worker(system, bus, f"victim-{number}") for number in range(3)}
    system.until("it is given up", lambda: state_of(system, poison) == (JobState.DEAD, 3))
    file = saved_job_path(system.data, poison)
    system.until("its input is saved", file.exists)
    assert read_saved_job(file).job.id == poison

    listed = covinz(system, "jobs")
    assert listed.returncode == 0, listed.stderr
    assert poison in listed.stdout and "dead_letter" in listed.stdout
    again = covinz(system, "jobs", "replay", poison, "--data", str(system.data), "--requeue")
    assert again.returncode == 0, again.stderr
    assert "waits for a loop solver again" in again.stdout
    assert "loop closure" in again.stdout or "rejected at" in again.stdout
    unknown = covinz(system, "jobs", "replay", "0" * 32, "--data", str(system.data))
    assert unknown.returncode == 1 and "knows no job" in unknown.stderr

    system.start("loop_solver", "worker-0")
    records = system.all_jobs_done(len(recording))
    assert all(record.state is JobState.DONE for record in records)
    assert outcomes(records) == test_jobs.expected_outcomes(system, records)


def test_restarts_of_the_router_are_no_failures_of_a_job(
    system: System, recording: Recording, open_bus: Callable[[], ZenohBus]
) -> None:
    system.start("optimizer")
    system.start("place_recognition")
    system.place_recognition_at_head(len(recording))
    worker = open_bus()
    assert worker.wait_connected(10.0)
    worker.declare_alive(keyexprs.worker_alive("patient"))
    lent = lease(worker, "patient")
    router = system.router
    for _ in range(3):
        router.kill()
        router.wait()
        router = system.start("router")
        assert worker.wait_connected(30.0)
        system.until("the worker is back with its job", lambda: is_leased_once(system, lent.job.id))
    solver = LoopSolver(system.config.loop_solver, RemoteKeyframeStore(system.bus, 64))
    assert bring(worker, "patient", lent, solver.solve(lent.job)) == Stored()
    assert state_of(system, lent.job.id) == (JobState.DONE, 1)


def test_a_worker_that_hangs_and_goes_on_has_no_second_effect(
    system: System, recording: Recording
) -> None:
    optimizer = system.start("optimizer")
    system.start("place_recognition")
    system.place_recognition_at_head(len(recording))
    slow = system.start("loop_solver", "slow")
    held = freeze_in_a_job(system, slow)
    system.start("loop_solver", "other")
    system.until("the other has done everything", lambda: is_over(system))
    before = list(client.jobs(system.bus))
    assert {r.job.id: r.attempts for r in before}[held] == 2
    slow.send_signal(signal.SIGCONT)

    def has_come() -> bool:
        status = system.status("place_recognition")
        return status is not None and status.counters.get("duplicate_outcomes", 0) == 1

    system.until("the late outcome has come", has_come)
    after = system.all_jobs_done(len(recording))
    assert [codec.encode(r.outcome) for r in after] == [codec.encode(r.outcome) for r in before]
    accepted = sum(isinstance(r.outcome, LoopClosure) for r in after)
    status = system.status("optimizer")
    assert status is not None and status.counters["loops"] == accepted
    assert optimizer.poll() is None


def test_two_workers_return_the_same_job(
    system: System, recording: Recording, open_bus: Callable[[], ZenohBus]
) -> None:
    system.start("place_recognition")
    system.place_recognition_at_head(len(recording))
    first, second = open_bus(), open_bus()
    assert first.wait_connected(10.0) and second.wait_connected(10.0)
    token = first.declare_alive(keyexprs.worker_alive("first"))
    lent = lease(first, "first")
    token.close()
    system.until("the lease has ended", lambda: state_of(system, lent.job.id)[1] == 1)
    again = lease(second, "second")
    assert again.job.id == lent.job.id
    job = lent.job
    no = Rejection(job.id, job.query, job.cand, "matches", 3.0, 30.0, "", 1.0)
    assert bring(second, "second", again, no) == Stored()
    assert bring(first, "first", lent, no) == Duplicate()
    assert state_of(system, job.id)[0] is JobState.DONE
