"""A scenario file: which robots to play, from what, and with what settings of the server.

Strings may hold environment variables, ``${NAME}`` or ``${NAME:-default}``. A relative `path` is
relative to the current directory (for the scenarios of the repository: its root); files of an
agent are relative to the agent's `path`. An agent takes what it does not say from `defaults`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from covinz.config import Config, ConfigError, Count, Section, merge, read_yaml, validate
from covinz.scenario.recordings import AslAgent, TumAgent, recorded_groundtruth
from covinz.scenario.rendered import RenderedAgent
from covinz.scenario.scenes import Scene
from covinz.trajectory import Trajectory, read_tum

_VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)(?::-([^}]*))?\}")

Agent = Annotated[TumAgent | AslAgent | RenderedAgent, Field(discriminator="reader")]


class Scenario(Section):
    """A run to play: agents and settings."""

    # Name of the run; part of its folder's name and of the sessions of a lockstep run.
    name: Annotated[str, Field(min_length=1)]
    # Settings of the server and of the agents' uploads that differ from the defaults.
    config: Mapping[str, Any] = {}
    # Added to the seeds of smooth paths, drift and images, so that one scenario gives many runs.
    seed: Count = 0
    # The world of the rendered agents.
    scene: Scene | None = None
    agents: Annotated[tuple[Agent, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> Scenario:
        ids = [agent.id for agent in self.agents]
        if len(set(ids)) != len(ids):
            raise ValueError("two agents have the same id")
        rendered = [agent.id for agent in self.agents if isinstance(agent, RenderedAgent)]
        if rendered and self.scene is None:
            raise ValueError(f"{rendered[0]} is rendered: give the scene it is in")
        return self

    def agent(self, agent_id: str) -> Agent:
        """The agent of a name; KeyError if there is none."""
        return {agent.id: agent for agent in self.agents}[agent_id]


def load_scenario(path: Path, environ: Mapping[str, str] | None = None) -> Scenario:
    """Read a scenario file.

    Args:
        path: YAML file: the fields of `Scenario`, and `defaults` for all its agents.
        environ: Environment variables; by default those of the process.

    Raises:
        ConfigError: If the file cannot be read, a variable is not set, or an entry is unknown,
            missing or out of range; the message names file and entry.
    """
    values = _expanded(read_yaml(path), os.environ if environ is None else environ, path)
    defaults = values.pop("defaults", {})
    agents = values.get("agents")
    if isinstance(defaults, dict) and isinstance(agents, list):
        values["agents"] = [merge(defaults, a) if isinstance(a, dict) else a for a in agents]
    scenario = validate(Scenario, values, str(path))
    validate(Config, scenario.config, f"{path}: config")
    return scenario


def groundtruth(scenario: Scenario, agent_id: str, played: Path) -> Trajectory | None:
    """True poses ``T_world_body`` of an agent; None where the scenario has none.

    All agents of a recording, and all rendered ones, share the world frame.

    Args:
        scenario: The scenario that was played.
        agent_id: One of its agents.
        played: Folder in which the player left the ground truth of rendered agents.

    Raises:
        TrajectoryError: If a file is missing or malformed.
        ConfigError: If the calibration is.
    """
    agent = scenario.agent(agent_id)
    if isinstance(agent, RenderedAgent):
        return read_tum(generated_groundtruth_file(agent_id, played))
    return recorded_groundtruth(agent)


def generated_groundtruth_file(agent_id: str, played: Path) -> Path:
    """Where the player leaves the ground truth of a rendered agent."""
    return played / f"{agent_id}.groundtruth.tum"


def _expanded(value: Any, environ: Mapping[str, str], path: Path) -> Any:
    """`value` with the environment variables in all its strings replaced."""
    if isinstance(value, dict):
        return {key: _expanded(below, environ, path) for key, below in value.items()}
    if isinstance(value, list):
        return [_expanded(below, environ, path) for below in value]
    if not isinstance(value, str):
        return value

    def text_of(match: re.Match[str]) -> str:
        name, default = match.groups()
        # As in a shell, `:-` also stands in for an empty variable.
        found = environ.get(name) or default
        if found is None:
            raise ConfigError(f"{path}: the environment variable {name} is not set")
        return found

    return _VARIABLE.sub(text_of, value)
