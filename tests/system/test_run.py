"""`covinz run` as a user calls it: what it leaves, and that killing processes changes nothing."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from covinz import client, evaluation
from covinz.bus import ZenohBus
from covinz.config import BusConfig
from covinz.run import free_port
from covinz.supervisor import Supervisor, server_specs
from covinz.trajectory import read_tum
from covinz.types import JobRecord, MapSnapshot

pytestmark = pytest.mark.slow

CHECKOUT = Path(__file__).resolve().parents[2]
SMALL = Path(__file__).with_name("small.yaml")
PATIENCE_S = 240.0
Json = dict[str, Any]


@dataclass(frozen=True)
class Run:
    """A finished run."""

    folder: Path
    output: str

    @property
    def report(self) -> Json:
        report: Json = json.loads((self.folder / "report.json").read_text())
        return report


def covinz(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "covinz.cli", *arguments],
        cwd=CHECKOUT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )


def finished(process: subprocess.Popen[str], folder: Path) -> Run:
    try:
        output, _ = process.communicate(timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=30)
        pytest.fail(f"the run did not end: {output[-2000:]}")
    assert process.returncode == 0, output[-3000:]
    return Run(folder, output)


def run(folder: Path, *options: str, scenario: Path = SMALL) -> Run:
    return finished(covinz("run", str(scenario), "--out", str(folder), *options), folder)


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The small scenario in lockstep, undisturbed."""
    return run(tmp_path_factory.mktemp("reference") / "run", "--lockstep")


@dataclass(frozen=True)
class Server:
    """What a server knows at its end."""

    jobs: list[JobRecord]
    maps: list[MapSnapshot]


def replayed(folder: Path, forget: tuple[str, ...]) -> Server:
    """Start the server of a run again, without the files to forget, and wait until it is idle."""
    settings = yaml.safe_load((folder / "config.yaml").read_text())
    settings["bus"]["endpoint"] = f"tcp/127.0.0.1:{free_port()}"
    config_file = folder / "replay.yaml"
    config_file.write_text(yaml.safe_dump(settings))
    for name in forget:
        for file in (folder / "server").glob(f"{name}.sqlite*"):
            file.unlink()
    specs = server_specs(config_file, folder / "server", workers=1)
    with Supervisor(specs, folder / "replay-logs"):
        bus = ZenohBus.open(BusConfig(endpoint=settings["bus"]["endpoint"]))
        try:
            client.wait_idle(bus, timeout_s=PATIENCE_S)
            return Server(list(client.jobs(bus)), client.snapshots(bus))
        finally:
            bus.close()


def graph_of(folder: Path) -> list[str]:
    """Vertices and edges of a run's map with all digits; comments name the revision."""
    lines = (folder / "map.g2o").read_text().splitlines()
    return [line for line in lines if not line.startswith("#")]


def test_a_run_leaves_what_it_promises(reference: Run) -> None:
    report = reference.report
    assert report["maps"] == [["agent0", "agent1"]]
    assert report["keyframes_lost"] == 0
    assert report["loops"]["accepted"] >= 5
    assert report["loops"]["inter_pairs"]["agent0-agent1"] >= 5
    assert report["loops"]["candidates"] == report["loops"]["accepted"] + sum(
        report["loops"]["rejected"].values()
    )
    assert report["solver_ms"]["median"] > 0
    assert report["kB_per_s_per_agent"] > 0
    assert 0 < report["server_s"] < report["wall_s"]
    for agent in ("agent0", "agent1"):
        assert report["agents"][agent]["keyframes"] > 5
        assert report["agents"][agent]["bytes"] > 10_000
    for picture in ("top_view", "map_3d", "error_over_time", "loops"):
        file = reference.folder / f"{picture}.png"
        assert file.read_bytes().startswith(b"\x89PNG")
        assert file.name in reference.output
    assert report["agents"]["agent0"]["path_m"] > 1.0
    assert sum(report["phases_s"].values()) == pytest.approx(report["wall_s"], abs=0.01)
    assert report["made_with"]["cpus"] >= 1
    assert "one map of 2 robots" in reference.output
    # Nobody sees bars in a log.
    assert "acked" not in reference.output and "\x1b" not in reference.output
    assert "VERTEX_SE3:QUAT" in (reference.folder / "map.g2o").read_text()


def test_the_files_of_a_run_agree_with_its_report(reference: Run) -> None:
    pairs = []
    for agent in ("agent0", "agent1"):
        truth = read_tum(reference.folder / f"{agent}.groundtruth.tum")
        after = read_tum(reference.folder / "trajectories" / f"{agent}.after.tum")
        assert len(after) == reference.report["agents"][agent]["keyframes"]
        pairs.append(evaluation.associate(after, truth))
    joint_m = evaluation.joint_ate_m(pairs)
    assert joint_m == pytest.approx(reference.report["joint_ate_after_m"], abs=1e-3)
    # Two robots that knew nothing of each other are now in one map, decimetres apart at most.
    assert joint_m < 0.5


def test_a_finished_run_says_why_there_is_a_loop(reference: Run) -> None:
    folder = str(reference.folder)
    why = finished(covinz("why", "agent1", "--run", folder), reference.folder)
    assert "loop closure" in why.output
    assert "agent0/" in why.output
    none = finished(covinz("why", "agent7/3", "--run", folder), reference.folder)
    assert "no candidate was ever found for agent7/3" in none.output


def test_the_map_is_the_same_after_place_recognition_and_optimizer_lost_everything(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "run"
    run(folder, "--lockstep")
    before = replayed(folder, forget=())
    after = replayed(folder, forget=("place_recognition", "optimizer"))
    assert [record.job.id for record in after.jobs] == [record.job.id for record in before.jobs]
    assert len(after.maps) == len(before.maps) == 1
    assert after.maps[0].keyframes == before.maps[0].keyframes
    assert np.array_equal(after.maps[0].T_map_body, before.maps[0].T_map_body)
    assert np.array_equal(after.maps[0].T_from_to, before.maps[0].T_from_to)


def test_a_lockstep_run_is_reproducible_with_any_number_of_workers(
    reference: Run, tmp_path: Path
) -> None:
    again = run(tmp_path / "run", "--lockstep", "--workers", "3")
    assert graph_of(again.folder) == graph_of(reference.folder)


PROCESSES = ("router", "ingest", "place_recognition", "optimizer", "loop_solver-0")


@pytest.mark.parametrize("victim", PROCESSES)
def test_a_run_survives_kill_9_of_any_process(victim: str, reference: Run, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    process = covinz("run", str(SMALL), "--out", str(folder), "--lockstep")
    try:
        pids = until(process, lambda: at_work(folder))
        os.kill(pids[victim]["pid"], signal.SIGKILL)
        done = finished(process, folder)
    finally:
        process.kill()
        process.wait()
    starts = json.loads((folder / "processes.json").read_text())
    assert starts[victim]["starts"] >= 2
    assert done.report["keyframes_lost"] == 0
    assert done.report["loops"]["accepted"] == reference.report["loops"]["accepted"]
    assert graph_of(folder) == graph_of(reference.folder)


def at_work(folder: Path) -> Json | None:
    """The processes, once the first loop has been found."""
    try:
        worker = (folder / "logs" / "loop_solver-0.log").read_text()
        pids: Json = json.loads((folder / "processes.json").read_text())
    except (FileNotFoundError, json.JSONDecodeError):
        return None
    return pids if re.search(r"inliers of", worker) else None


def until(process: subprocess.Popen[str] | None, look: Callable[[], Json | None]) -> Json:
    """What `look` finds, while a process runs that must not end before."""
    deadline = time.monotonic() + PATIENCE_S
    pause = threading.Event()
    while (found := look()) is None:
        if process is not None:
            assert process.poll() is None, process.communicate()[0][-3000:]
        assert time.monotonic() < deadline
        pause.wait(0.02)
    return found


@pytest.fixture
def live_server(tmp_path: Path) -> Iterator[str]:
    """`covinz up` on a free port; gives the endpoint."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config_file = tmp_path / "config.yaml"
    config_file.write_text(yaml.safe_dump({"bus": {"endpoint": endpoint}}))
    process = covinz("up", "--config", str(config_file), "--data", str(tmp_path / "data"))
    try:
        yield endpoint
    finally:
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=60)
        assert process.returncode == 0, output


def test_a_user_can_ask_a_live_server(live_server: str, tmp_path: Path) -> None:
    bus = ZenohBus.open(BusConfig(endpoint=live_server))
    try:
        client.wait_idle(bus, timeout_s=PATIENCE_S)
    finally:
        bus.close()
    status = finished(covinz("status", "--endpoint", live_server), tmp_path)
    for name in ("ingest", "place_recognition", "optimizer", "loop_solver-0", "idle"):
        assert name in status.output
    why = finished(covinz("why", "agent0/3", "--endpoint", live_server), tmp_path)
    assert "no candidate was ever found for agent0/3" in why.output
    finished(covinz("export", "--out", str(tmp_path / "x"), "--endpoint", live_server), tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "nowhere.yaml"), "does not exist"),
        (("run", str(SMALL), "--rate", "1", "--lockstep"), "exclude each other"),
        (("run", str(SMALL), "--profile", "unknown"), "profile"),
        (("run", str(SMALL), "--out", "docs"), "docs is not empty"),
        (("run", str(SMALL), "--out", "README.md"), "cannot make the run folder README.md"),
        (("status", "--endpoint", "tcp/127.0.0.1:9"), "tcp/127.0.0.1:9: nobody listens there"),
        (("status", "--endpoint", "nonsense"), "not an endpoint: 'nonsense'"),
        (("eval", "-g", "README.md", "README.md"), "README.md:"),
        (("why", "agent0", "--run", "docs"), "cannot read docs/candidates.csv"),
        (("up", "--data", "README.md/data"), "README.md/data/server"),
    ],
)
def test_a_wrong_call_says_what_is_wrong(arguments: tuple[str, ...], message: str) -> None:
    process = covinz(*arguments)
    output, _ = process.communicate(timeout=60)
    assert process.returncode != 0
    assert message in " ".join(output.split())
    assert "Traceback" not in output


def test_a_scenario_without_its_recording_starts_nothing(tmp_path: Path) -> None:
    scenario = tmp_path / "recorded.yaml"
    odometry = {"source": "file", "file": "odometry.tum", "frame": "body"}
    agent = {"id": "a0", "reader": "tum", "path": str(tmp_path / "gone"), "odometry": odometry}
    scenario.write_text(yaml.safe_dump({"name": "recorded", "agents": [agent]}))
    process = covinz("run", str(scenario), "--out", str(tmp_path / "run"))
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert f"there is no recording in {tmp_path / 'gone'}" in output
    assert not (tmp_path / "run").exists()


def test_a_second_server_leaves_the_first_alone(live_server: str, tmp_path: Path) -> None:
    config_file = tmp_path / "second.yaml"
    for endpoint, data, message in (
        (live_server, "other", f"cannot listen on {live_server}"),
        (f"tcp/127.0.0.1:{free_port()}", "data", "in use by another process"),
    ):
        bus = ZenohBus.open(BusConfig(endpoint=live_server))
        try:
            client.wait_idle(bus, timeout_s=PATIENCE_S)
        finally:
            bus.close()
        config_file.write_text(yaml.safe_dump({"bus": {"endpoint": endpoint}}))
        second = covinz("up", "--config", str(config_file), "--data", str(tmp_path / data))
        output, _ = second.communicate(timeout=60)
        assert second.returncode == 1
        assert message in output
        assert "Traceback" not in output
    written = yaml.safe_load((tmp_path / "data" / "config.yaml").read_text())
    assert written["bus"]["endpoint"] == live_server


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_run_that_is_stopped_leaves_no_process(number: signal.Signals, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    process = covinz("run", str(SMALL), "--out", str(folder), "--rate", "1")
    try:
        pids = until(process, lambda: processes_of(folder) if playing(folder) else None)
        assert len(pids) >= 6  # five of the server, and the agents
        process.send_signal(number)
        # Ends when the last of them has closed it.
        process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.wait()
    assert process.returncode != 0
    until(None, lambda: {} if not processes_of(folder) else None)


def playing(folder: Path) -> bool:
    return any((folder / "spool").glob("*.sqlite"))


def processes_of(folder: Path) -> Json:
    """Command lines of the processes that were told to work in a folder, but for the run itself."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes().decode().split("\0")
        except (OSError, UnicodeDecodeError):
            continue
        if "covinz.cli" not in words and any(word.startswith(f"{folder}/") for word in words):
            found[entry.name] = words
    return found


@pytest.mark.data
def test_three_robots_in_a_kitchen_end_up_in_one_map(
    recorded_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COVINZ_DATA", str(recorded_data))
    scenario = CHECKOUT / "scenarios" / "redkitchen.yaml"
    report = run(tmp_path / "run", "--lockstep", scenario=scenario).report
    loops = report["loops"]
    assert report["maps"] == [["agent0", "agent1", "agent2"]]
    assert report["keyframes_lost"] == 0
    assert loops["inter_pairs"]["agent0-agent1"] >= 5
    assert loops["inter_pairs"]["agent0-agent2"] >= 5
    assert loops["wrong"] <= 0.05 * loops["accepted"]
    assert loops["t_err_median_m"] <= 0.10
    assert loops["r_err_median_deg"] <= 2.5
