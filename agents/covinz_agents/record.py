"""Writes the images of a scenario's robots as recordings that any SLAM system can play.

python -m covinz_agents.record SCENARIO --out DIR [--layout asl|tum]

Each robot has a folder of its own, named by its id; ``scenario.yaml`` beside them plays them again.
Exit code 0: all is written; 2: the scenario, its data or the folder cannot be used.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.progress import Progress

from covinz.config import ConfigError
from covinz.scenario import Agent, Scenario, load_scenario
from covinz.trajectory import TrajectoryError
from covinz_agents.layouts import LAYOUTS, ODOMETRY
from covinz_agents.source import DatasetError
from covinz_agents.staging import open_source

log = logging.getLogger(__name__)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    arguments = _parser().parse_args(argv)
    try:
        record(load_scenario(arguments.scenario), arguments.out, arguments.layout)
    except (ConfigError, DatasetError, TrajectoryError, OSError) as error:
        log.error("%s", error)
        return 2
    return 0


def record(scenario: Scenario, out: Path, layout: str) -> None:
    """Write the robots of a scenario and a scenario that plays what was written.

    Args:
        scenario: Whose robots.
        out: Folder to make; it must be empty if it is there.
        layout: One of `LAYOUTS`.

    Raises:
        DatasetError: If a robot's images cannot be had, or `out` is not empty.
        TrajectoryError, ConfigError: If a recording cannot be read.
        OSError: If a file cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    if any(out.iterdir()):
        raise DatasetError(f"{out} is not empty")
    write, _ = LAYOUTS[layout]
    with Progress(console=Console(stderr=True)) as bars:
        for agent in scenario.agents:
            robot = open_source(agent, scenario)
            task = bars.add_task(agent.id, total=len(robot.frames))
            write(out / agent.id, robot, lambda done, task=task: bars.update(task, completed=done))  # type: ignore[misc]
    entries = [_entry(agent, out, layout) for agent in scenario.agents]
    played = {"name": scenario.name, "config": dict(scenario.config), "agents": entries}
    (out / "scenario.yaml").write_text(yaml.safe_dump(played, sort_keys=False))


def _entry(agent: Agent, out: Path, layout: str) -> dict[str, Any]:
    """An agent of the scenario that plays what was written."""
    _, truth = LAYOUTS[layout]
    folder = out.resolve() / agent.id
    named = {name: value for name, value in truth.items() if _exists(folder, value)}
    return {
        "id": agent.id,
        "reader": layout,
        "path": str(folder),
        "odometry": {"source": "file", "file": str(ODOMETRY), "frame": "body"},
        **(named or {"groundtruth": None}),
        "keyframes": agent.keyframes.model_dump(mode="json"),
        "features": agent.features.model_dump(mode="json"),
    }


def _exists(folder: Path, named: object) -> bool:
    file = named["file"] if isinstance(named, dict) else named
    return (folder / str(file)).is_file()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m covinz_agents.record", description="Write a scenario's images as data sets."
    )
    parser.add_argument("scenario", type=Path, help="scenario file")
    parser.add_argument("--out", type=Path, required=True, help="folder to make")
    parser.add_argument("--layout", choices=sorted(LAYOUTS), default="asl", help="[asl]")
    return parser


if __name__ == "__main__":
    sys.exit(main())
