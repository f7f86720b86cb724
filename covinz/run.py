"""One run of a scenario: start a server, play the agents, wait until idle, evaluate, stop."""

from __future__ import annotations

import json
import logging
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from covinz import client, config, keyexprs, provenance, record, report, results
from covinz.bus import Bus, ZenohBus
from covinz.scenario import AslAgent, Scenario, TumAgent, load_scenario
from covinz.supervisor import Supervisor, child_environment, die_with_parent, server_specs

log = logging.getLogger(__name__)

START_TIMEOUT_S = 60.0


class RunFailed(RuntimeError):
    """The run could not be finished; the message says where to look."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How to run a scenario.

    Attributes:
        workers: Loop-solver processes.
        profile: Solver profile.
        rate: Multiple of real time; None plays as fast as the server acknowledges.
        lockstep: One keyframe at a time in stamp order across agents.
        seed: Instead of the scenario's seed.
        out: Run folder; None makes ``runs/<name>-<time>``.
    """

    workers: int = 1
    profile: str = "fast"
    rate: float | None = None
    lockstep: bool = False
    seed: int | None = None
    out: Path | None = None


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run left: its folder, the files to look at and the report that is among them."""

    folder: Path
    files: Sequence[Path]
    report: dict[str, Any]


def run_scenario(scenario_file: Path, options: RunOptions, console: Console) -> RunResult:
    """Run a scenario from start to report.

    Raises:
        ConfigError: If the scenario or an override in it is not usable.
        RunFailed: If a recording is not there, the server does not come up or the agents cannot
            be played.
    """
    watch = _Watch()
    scenario = load_scenario(scenario_file)
    if options.seed is not None:
        scenario = scenario.model_copy(update={"seed": options.seed})
    _require_recordings(scenario)
    settings = server_config(scenario, options)
    folder = make_run_folder(scenario.name, options.out)
    written = folder / "config.yaml"
    written.write_text(yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False))
    specs = server_specs(written.resolve(), (folder / "server").resolve(), options.workers)
    (folder / "server").mkdir(exist_ok=True)
    with Supervisor(specs, folder / "logs", folder / "processes.json"):
        bus = ZenohBus.open(settings.bus)
        try:
            _wait_for_services(bus, len(specs) - 1, folder)
            watch.lap("start")
            played = _play(scenario_file, settings.bus.endpoint, options, folder, console)
            watch.lap("stage", played["staged_s"])
            watch.lap("play")
            _wait_until_idle(bus, console)
            watch.lap("drain")
            server_s = watch.laps_s["play"] + watch.laps_s["drain"]
            left = record.collect(
                bus, scenario, played["agents"], folder, server_s, settings.optimizer.cauchy_scale
            )
        finally:
            bus.close()
    watch.lap("stop")
    made = report.build(left)
    watch.lap("evaluate")
    made["wall_s"] = round(sum(watch.laps_s.values()), 3)
    made["phases_s"] = {name: round(lap_s, 3) for name, lap_s in watch.laps_s.items()}
    made["options"] = {
        "workers": options.workers,
        "profile": options.profile,
        "rate": options.rate,
        "lockstep": options.lockstep,
        "seed": scenario.seed,
    }
    made["made_with"] = provenance.provenance(settings)
    return RunResult(folder, results.write(folder, left, made), made)


class _Watch:
    """Times the phases of a run one after another."""

    def __init__(self) -> None:
        self.laps_s: dict[str, float] = {}
        self._since = time.monotonic()

    def lap(self, name: str, lasted_s: float | None = None) -> None:
        """End a phase, now or when it had lasted so long; the next begins."""
        now = time.monotonic() if lasted_s is None else self._since + lasted_s
        self.laps_s[name] = now - self._since
        self._since = now


def _require_recordings(scenario: Scenario) -> None:
    for agent in scenario.agents:
        if isinstance(agent, TumAgent | AslAgent) and not agent.path.is_dir():
            raise RunFailed(
                f"{agent.id}: there is no recording in {agent.path}; the scenarios of the "
                "repository look for theirs below the folder that COVINZ_DATA or EUROC names"
            )


def server_config(scenario: Scenario, options: RunOptions) -> config.Config:
    """The scenario's settings and the environment's, with a loopback port of its own."""
    values = config.merge(
        config.with_environment(scenario.config),
        {
            "bus": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
            "loop_solver": {"profile": options.profile},
        },
    )
    return config.validate(config.Config, values, f"config of scenario {scenario.name}")


def free_port() -> int:
    """A loopback TCP port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def make_run_folder(name: str, out: Path | None) -> Path:
    """Make the run's folder and let ``runs/latest`` point to it when it lies in ``runs``."""
    if out is not None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunFailed(f"cannot make the run folder {out}: {error.strerror}") from error
        if any(out.iterdir()):
            raise RunFailed(f"{out} is not empty; a run never overwrites another")
        return out
    slug = re.sub(r"[^A-Za-z0-9_-]+", "-", name)
    folder = Path("runs") / f"{slug}-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}"
    folder.mkdir(parents=True)
    latest = Path("runs") / "latest"
    latest.unlink(missing_ok=True)
    latest.symlink_to(folder.name)
    return folder


def _wait_for_services(bus: Bus, count: int, folder: Path) -> None:
    """Wait until `count` services besides the router hold their liveliness token."""
    alive: set[str] = set()
    complete = threading.Event()
    lock = threading.Lock()

    def seen(key: str, here: bool) -> None:
        with lock:
            (alive.add if here else alive.discard)(key)
            if len([key for key in alive if "/router/" not in key]) >= count:
                complete.set()

    watch = bus.watch_alive(keyexprs.SERVICES_ALIVE, seen)
    try:
        if not complete.wait(START_TIMEOUT_S):
            names = ", ".join(sorted("/".join(keyexprs.service_of(key)) for key in alive))
            raise RunFailed(
                f"after {START_TIMEOUT_S:.0f} s only these services are up: {names or 'none'}; "
                f"see {folder / 'logs'}"
            )
    finally:
        watch.close()


def _play(
    scenario_file: Path, endpoint: str, options: RunOptions, folder: Path, console: Console
) -> dict[str, Any]:
    """Play all agents in a process of their own; returns the player's summary."""
    summary = folder / "agents.json"
    argv = [sys.executable, "-m", "covinz_agents.play", str(scenario_file)]
    argv += ["--endpoint", endpoint, "--spool", str(folder / "spool"), "--summary", str(summary)]
    argv += ["--lockstep"] if options.lockstep else []
    argv += ["--rate", str(options.rate)] if options.rate is not None else []
    argv += ["--seed", str(options.seed)] if options.seed is not None else []
    # Bars are for a terminal; in a log they are noise.
    argv += [] if console.is_terminal else ["--no-progress"]
    player = subprocess.Popen(argv, env=child_environment(), preexec_fn=die_with_parent)
    try:
        code = player.wait()
    except BaseException:
        player.send_signal(signal.SIGTERM)
        player.wait()
        raise
    if code != 0:
        raise RunFailed(f"playing the agents ended with code {code}; why is said above")
    played: dict[str, Any] = json.loads(summary.read_text())
    return played


def _wait_until_idle(bus: Bus, console: Console) -> None:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    quiet = not console.is_terminal
    with Progress(
        *columns, TimeElapsedColumn(), console=console, transient=True, disable=quiet
    ) as bars:
        update = _server_bars(bars)
        client.wait_idle(bus, on_progress=update)


def _server_bars(bars: Progress) -> Callable[[client.Progress], None]:
    looked_up = bars.add_task("server: looked up", total=None)
    jobs = bars.add_task("server: jobs left", total=None)
    most = 1

    def update(now: client.Progress) -> None:
        nonlocal most
        most = max(most, now.open_jobs)
        bars.update(looked_up, completed=now.looked_up, total=now.head)
        bars.update(jobs, completed=most - now.open_jobs, total=most)

    return update
