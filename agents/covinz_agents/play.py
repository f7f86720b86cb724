"""Plays the robots of a scenario against a running server.

python -m covinz_agents.play SCENARIO --endpoint tcp/HOST:7447 --spool DIR [--summary FILE]

Exit code 0: the server has every keyframe; 1: it has not, the spools keep the rest; 2: the
scenario, its data or a spool cannot be used.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from covinz.config import BusConfig, ConfigError
from covinz.scenario import Scenario, load_scenario
from covinz.signals import stop_event
from covinz.spool import SpoolError
from covinz.trajectory import TrajectoryError
from covinz_agents.player import NotDelivered, PlayOptions, Report, Robot, play
from covinz_agents.source import DatasetError, RenderingStopped
from covinz_agents.staging import OnRendering

log = logging.getLogger(__name__)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    arguments = _parser().parse_args(argv)
    results = arguments.summary.parent if arguments.summary else arguments.spool
    options = PlayOptions(
        endpoint=arguments.endpoint,
        spool=arguments.spool,
        results=results,
        rate=arguments.rate,
        lockstep=arguments.lockstep,
        patience_s=arguments.patience,
        credentials=arguments.credentials,
    )
    stop = stop_event()
    try:
        scenario = load_scenario(arguments.scenario)
        if arguments.seed is not None:
            scenario = scenario.model_copy(update={"seed": arguments.seed})
        with _progress(arguments.progress) as progress:
            bars = _bars(progress, scenario)
            summary = play(scenario, options, stop, bars, _rendering_bar(progress))
    except (ConfigError, DatasetError, SpoolError, TrajectoryError) as error:
        log.error("%s", error)
        return 2
    except (NotDelivered, RenderingStopped) as error:
        log.error("%s", error)
        return 1
    if arguments.summary:
        results.mkdir(parents=True, exist_ok=True)
        arguments.summary.write_text(json.dumps(summary, indent=2) + "\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m covinz_agents.play", description="Play the robots of a scenario."
    )
    parser.add_argument("scenario", type=Path, help="scenario file")
    parser.add_argument("--endpoint", default=BusConfig().endpoint, help="the server's router")
    parser.add_argument(
        "--credentials", type=Path, help="folder with ROBOT.covinz for each, in place of --endpoint"
    )
    parser.add_argument("--spool", type=Path, required=True, help="folder for the robots' spools")
    parser.add_argument("--seed", type=_count, help="instead of the scenario's seed")
    parser.add_argument("--summary", type=Path, help="JSON file to write when all is delivered")
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument("--rate", type=_positive, help="multiple of real time [as fast as acked]")
    pace.add_argument("--lockstep", action="store_true", help="one at a time, in stamp order")
    parser.add_argument(
        "--patience", type=_positive, default=120.0, help="give up after so long without an ack [s]"
    )
    parser.add_argument(
        "--progress", action=argparse.BooleanOptionalAction, default=True, help="show bars"
    )
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError
    return value


def _progress(shown: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[done]}"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        disable=not shown,
    )


def _bars(progress: Progress, scenario: Scenario) -> Report:
    tasks = {a.id: progress.add_task(a.id, total=None, done="") for a in scenario.agents}

    def report(robots: Sequence[Robot]) -> None:
        for robot in robots:
            total, acked = len(robot.keyframes), robot.acked
            done = f"{robot.sent} sent, {acked}/{total} acked"
            progress.update(tasks[robot.id], total=total, completed=acked, done=done)

    return report


def _rendering_bar(progress: Progress) -> OnRendering:
    task: TaskID | None = None

    def report(rendered: int, total: int) -> None:
        nonlocal task
        if task is None:
            task = progress.add_task("rendering", total=total, done="")
        done = f"{rendered} of {total} images, first run only"
        progress.update(task, completed=rendered, done=done)

    return report


if __name__ == "__main__":
    sys.exit(main())
