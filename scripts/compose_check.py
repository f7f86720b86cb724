"""What scripts/compose_check.sh does once there is an engine; that file says what is checked."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from covinz import client
from covinz.bus import Bus, ZenohBus
from covinz.config import ENVIRONMENT_PREFIX, BusConfig
from covinz.run import free_port
from covinz.scenario import load_scenario
from covinz.supervisor import child_environment
from scripts.compose_access import Access, let_in
from scripts.compose_project import (
    CHECKOUT,
    IMAGE,
    PATIENCE_S,
    CheckFailed,
    ComposeProject,
    inspect,
    kill_process,
    memory,
    until,
)

DEFAULT_SCENARIO = CHECKOUT / "scenarios" / "hall.yaml"
# Who is let in is in sooner. [s]
CONNECT_S = 3.0
BEGAN_S = time.monotonic()


def main() -> int:
    """Run the check; returns the exit code."""
    arguments = _parser().parse_args()
    # Like Ctrl-C, SIGTERM must take the project down.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    scenario = load_scenario(arguments.scenario)
    compose = os.environ.get("COMPOSE", "docker compose").split()
    with tempfile.TemporaryDirectory(prefix="covinz-compose-check-") as temporary:
        folder = arguments.keep or Path(temporary)
        name, port = f"covinz-check-{os.getpid()}", free_port()
        settings = environment(scenario.config)
        project = ComposeProject(compose, name, port, folder, settings, arguments.tls)
        robots = sorted(agent.id for agent in scenario.agents)
        try:
            image(project)
            access = Access(port)
            if arguments.tls:
                access = let_in(project, port, robots, folder / "credentials")
                say(f"{len(robots)} robots and an operator in the roster")
            check(project, access, arguments, robots, folder)
        except (CheckFailed, client.ServerUnavailable, TimeoutError) as error:
            sys.stderr.write(project.logs())
            say(f"FAILED: {error}")
            return 1
        finally:
            project.down(volumes=True)
            say("containers, volumes and network removed")
    say("PASSED")
    return 0


def check(
    project: ComposeProject,
    access: Access,
    arguments: argparse.Namespace,
    robots: list[str],
    folder: Path,
) -> None:
    """Everything, in order; raises CheckFailed."""
    project.up(3)
    say("up with 3 loop solvers, all healthy")
    with closing(ZenohBus.open(access.bus())) as bus:
        with played(arguments.scenario, access, arguments.rate, folder) as player:
            disturb(project, bus, player)
            if player.wait(PATIENCE_S) != 0:
                raise CheckFailed(f"the player ended with {player.returncode}")
        say("all robots have delivered everything")
        client.wait_idle(bus, PATIENCE_S)
        say("server idle")
        project.up(5)
        say("all containers healthy")
    covinz("doctor", access=access)
    say("the doctor finds nothing bad")
    if access.credentials is not None:
        stay_out(access)
        say("nobody gets in without credentials")
    look_at(report(arguments.scenario, access, folder), robots)
    for line in memory(project.containers()):
        say(f"memory: {line}")
    before = exported(access, folder / "before")
    project.down(volumes=False)
    say("everything stopped, containers removed")
    project.up(3)
    with closing(ZenohBus.open(access.bus())) as bus:
        client.wait_idle(bus, PATIENCE_S)
    if exported(access, folder / "after") != before:
        raise CheckFailed(f"the map is another after a restart: {folder}/before, {folder}/after")
    lines = sum(len(text.splitlines()) for text in before.values())
    say(f"up again: same map, {lines} lines of {len(before)} exported files are equal")


def disturb(project: ComposeProject, bus: Bus, player: subprocess.Popen[bytes]) -> None:
    """While the robots send: one worker, then five, then one of them is killed."""
    for keyframes, workers in ((10, 1), (30, 5)):
        reach(bus, player, keyframes)
        project.up(workers, wait=False)
        reach_workers(bus, workers)
        say(f"scaled to {workers} loop solvers with {head(bus)} keyframes in the log")
    reach(bus, player, 50)
    victim = project.containers("loop_solver")[0]
    kill_process(victim)
    until("a killed loop solver was started again", lambda: restarted(victim))
    reach_workers(bus, 5)
    say(f"a killed loop solver is back with {head(bus)} keyframes in the log")
    if player.poll() is not None:
        raise CheckFailed("the robots had finished before the worker was back; lower --rate")


def image(project: ComposeProject) -> None:
    """Build it."""
    project.build()
    say(f"image built: {inspect(IMAGE)['Size'] / 1e6:.0f} MB")


def stay_out(access: Access) -> None:
    """Raise CheckFailed if somebody without credentials gets in."""
    with closing(ZenohBus.open(BusConfig(endpoint=access.endpoint))) as bus:
        if bus.wait_connected(CONNECT_S):
            raise CheckFailed("the server let somebody in who has no credentials")


def reach(bus: Bus, player: subprocess.Popen[bytes], keyframes: int) -> None:
    """Wait until so many keyframes are in the log."""

    def look() -> bool | None:
        if head(bus) >= keyframes:
            return True
        if player.poll() is not None:
            raise CheckFailed(f"the player ended with {player.returncode} too early")
        return None

    until(f"{keyframes} keyframes in the log", look)


def head(bus: Bus) -> int:
    """Entries in the log."""
    return client.progress(bus).head


def reach_workers(bus: Bus, count: int) -> None:
    """Wait until so many loop solvers answer for themselves, no more and no less."""

    def look() -> bool | None:
        return True if len(client.statuses(bus, "loop_solver")) == count else None

    until(f"{count} loop solvers answered", look)


def restarted(container: str) -> bool | None:
    """Whether the engine has started a container again by itself."""
    return True if inspect(container)["RestartCount"] > 0 else None


@contextmanager
def played(
    scenario: Path, access: Access, rate: float, folder: Path
) -> Iterator[subprocess.Popen[bytes]]:
    """The robots of a scenario, played from outside of the containers."""
    argv = [sys.executable, "-m", "covinz_agents.play", str(scenario), *access.of_robots]
    argv += ["--rate", str(rate), "--spool", str(folder / "spool"), "--no-progress"]
    argv += ["--summary", str(folder / "agents.json")]
    player = subprocess.Popen(argv, env=child_environment(), cwd=CHECKOUT)
    try:
        yield player
    finally:
        player.terminate()
        player.wait()


def report(scenario: Path, access: Access, folder: Path) -> dict[str, Any]:
    """`covinz report` of the running server."""
    out = folder / "report"
    covinz("report", str(scenario), "--played", str(folder), "--out", str(out), access=access)
    made: dict[str, Any] = json.loads((out / "report.json").read_text())
    return made


def look_at(made: Mapping[str, Any], robots: list[str]) -> None:
    """Raise CheckFailed for a report that does not keep the promises."""
    loops = made["loops"]
    found = f"{loops['accepted']} loops of {loops['candidates']} candidates, {loops['wrong']} wrong"
    say(f"report: maps {made['maps']}, {found}, {made['keyframes_lost']} keyframes lost")
    say(f"report: joint ATE {made['joint_ate_before_m']} m -> {made['joint_ate_after_m']} m")
    if made["maps"] != [robots]:
        raise CheckFailed(f"expected one map of {robots}")
    if made["keyframes_lost"] != 0:
        raise CheckFailed("keyframes were lost")
    if loops["candidates"] != loops["accepted"] + sum(loops["rejected"].values()):
        raise CheckFailed("there are candidates without an outcome")


def exported(access: Access, folder: Path) -> dict[str, str]:
    """What `covinz export` writes, by file; without the revision, which counts optimisations."""
    covinz("export", "--out", str(folder), access=access)
    return {
        file.name: "\n".join(
            line for line in file.read_text().splitlines() if not line.startswith("# map ")
        )
        for file in sorted(folder.iterdir())
    }


def covinz(*arguments: str, access: Access) -> None:
    """Run a covinz command as a user does."""
    argv = [sys.executable, "-m", "covinz.cli", *arguments, *access.of_commands]
    if subprocess.run(argv, cwd=CHECKOUT, stdout=subprocess.DEVNULL).returncode != 0:
        raise CheckFailed(f"covinz {arguments[0]} failed")


def environment(settings: Mapping[str, Any], prefix: str = ENVIRONMENT_PREFIX) -> dict[str, str]:
    """A scenario's settings as variables: ``{"a": {"b": 1}}`` is ``COVINZ__A__B=1``."""
    variables: dict[str, str] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            variables |= environment(value, f"{prefix}{name.upper()}__")
        else:
            variables[f"{prefix}{name.upper()}"] = json.dumps(value)
    return variables


def say(text: str) -> None:
    """One line of the check's log."""
    print(f"[{time.monotonic() - BEGAN_S:6.1f} s] {text}", flush=True)


def _new_folder(text: str) -> Path:
    folder = Path(text)
    if folder.exists():
        raise argparse.ArgumentTypeError(f"{folder} is there already")
    folder.mkdir(parents=True)
    return folder


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="scripts/compose_check.sh", description=__doc__)
    parser.add_argument("scenario", type=Path, nargs="?", default=DEFAULT_SCENARIO)
    parser.add_argument("--tls", action="store_true", help="with docker-compose.tls.yml on top")
    parser.add_argument("--rate", type=float, default=1.0, help="multiple of real time [1]")
    parser.add_argument(
        "--keep", type=_new_folder, metavar="FOLDER", help="keep report and maps in a new folder"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
