"""The report of a server that runs, for robots that were played against it from elsewhere."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from covinz import client, provenance, record, report, results
from covinz.bus import Bus
from covinz.config import Config
from covinz.run import RunFailed, RunResult, make_run_folder
from covinz.scenario import load_scenario

SUMMARY_FILE = "agents.json"
# For what the robots have sent before to be worked off. [s]
IDLE_TIMEOUT_S = 600.0


def report_server(
    bus: Bus, scenario_file: Path, played: Path, out: Path | None, settings: Config
) -> RunResult:
    """Wait until the server is idle, evaluate its maps and leave what `covinz run` leaves.

    The server must have been new to the scenario's robots: all their sessions count, but the
    player's summary is that of the last.

    Args:
        bus: A bus that is connected.
        scenario_file: What was played.
        played: Folder that the player's ``--summary FOLDER/agents.json`` was in: the summary and
            the ground truth of rendered robots.
        out: Folder to write, as for `make_run_folder`.
        settings: Of the server.

    Raises:
        RunFailed: If there is no summary, or the folder cannot be used.
        ConfigError, TrajectoryError: If the scenario or its ground truth cannot be read.
        ServerUnavailable: If a part of the server does not answer.
        TimeoutError: If the server is still at work after 10 minutes.
    """
    scenario = load_scenario(scenario_file)
    summary = read_summary(played)
    client.wait_idle(bus, IDLE_TIMEOUT_S)
    # Nobody has measured how long the server took.
    left = record.collect(bus, scenario, summary, played, math.nan, settings.optimizer.cauchy_scale)
    made = report.build(left) | {"server_s": None, "made_with": provenance.provenance(settings)}
    folder = make_run_folder(scenario.name, out)
    return RunResult(folder, results.write(folder, left, made), made)


def read_summary(played: Path) -> dict[str, Any]:
    """What the player says of its robots, by agent; raises RunFailed."""
    file = played / SUMMARY_FILE
    try:
        agents: dict[str, Any] = json.loads(file.read_text())["agents"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunFailed(
            f"no summary of a player in {file} ({error}); play with --summary {file}"
        ) from error
    return agents
