"""Scenarios: which robots to play, from what, and with what settings of the server.

Strings may hold environment variables, ``${NAME}`` or ``${NAME:-default}``. A relative `path` is
relative to the current directory (for the scenarios of the repository: its root); files of an
agent are relative to the agent's `path`. An agent takes what it does not say from `defaults`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from covinz import frames
from covinz.calibration import read_T_body_cam
from covinz.config import (
    Config,
    ConfigError,
    Count,
    FeatureConfig,
    KeyframeSelectionConfig,
    NonNegative,
    Positive,
    Section,
    merge,
    read_yaml,
    validate,
)
from covinz.trajectory import Trajectory, parse_stamp_ns, read_tum
from covinz.types import AGENT_PATTERN

_VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)(?::-([^}]*))?\}")
_AgentId = Annotated[str, Field(pattern=f"^{AGENT_PATTERN.pattern}$")]
_Finite = Annotated[float, Field(allow_inf_nan=False)]

PoseFrame = Literal["body", "camera"]


class Drift(Section):
    """Random walk added to true motion, so that it drifts like odometry; zero adds nothing."""

    # Rotation per square root of metre travelled. [rad / sqrt(m)]
    rotation_per_sqrt_m: NonNegative = 0.01
    # Rotation per square root of radian turned. [rad / sqrt(rad)]
    rotation_per_sqrt_rad: NonNegative = 0.02
    # Translation per square root of metre travelled. [m / sqrt(m)]
    translation_per_sqrt_m: NonNegative = 0.03
    # Translation per square root of radian turned. [m / sqrt(rad)]
    translation_per_sqrt_rad: NonNegative = 0.03
    # Seed of the random walk; agents with the same seed still drift differently.
    seed: Count = 0


class FileOdometry(Section):
    """Odometry recorded in a TUM trajectory file."""

    source: Literal["file"]
    file: Path
    # Whose pose it is: the body's, or the camera's (then the camera's T_body_cam is applied).
    frame: PoseFrame


class DriftingGroundTruth(Section):
    """Odometry made of the ground truth and seeded drift, for recordings without odometry."""

    source: Literal["groundtruth_drift"]
    drift: Drift = Drift()


class GroundTruthFile(Section):
    """Ground truth in a TUM trajectory file."""

    file: Path
    # Whose pose it is.
    frame: PoseFrame


class TumAgent(Section):
    """A robot played from a recording in the layout of the TUM RGB-D data sets."""

    id: _AgentId
    reader: Literal["tum"]
    # Folder of the recording.
    path: Path
    # List of images: ``timestamp filename``.
    images: Path = Path("rgb.txt")
    # First and last frame to use. A frame's number is its file's name where all names are
    # integers, else its row in the list, from 0.
    frames: tuple[Count, Count] | None = None
    # First and last time to use, in decimal seconds; as text, to keep nanoseconds.
    times_s: tuple[str, str] | None = None
    # Calibration: `calib.yaml` (see covinz.calibration) or TUM's `calib.txt`.
    camera: Path = Path("calib.yaml")
    odometry: Annotated[FileOdometry | DriftingGroundTruth, Field(discriminator="source")]
    groundtruth: GroundTruthFile | None = None
    # An image between two poses further apart than this has no pose and is left out. [s]
    max_pose_gap_s: Positive = 0.1
    keyframes: KeyframeSelectionConfig = KeyframeSelectionConfig()
    features: FeatureConfig = FeatureConfig()

    @model_validator(mode="after")
    def _check(self) -> TumAgent:
        if self.frames is not None and self.times_s is not None:
            raise ValueError("give frames or times_s, not both")
        if self.frames is not None and self.frames[0] > self.frames[1]:
            raise ValueError("the first frame comes after the last")
        times = [parse_stamp_ns(text) for text in self.times_s or ()]
        if times != sorted(times):
            raise ValueError("the first time comes after the last")
        if isinstance(self.odometry, DriftingGroundTruth) and self.groundtruth is None:
            raise ValueError("odometry from drifting ground truth needs groundtruth")
        return self


class Walk(Section):
    """Path of a simulated robot: laps of an ellipse through the hall, at a height that sways."""

    # Centre and half axes of the ellipse; the hall's floor is centred on the origin. [m]
    center_m: tuple[_Finite, _Finite] = (0.0, 0.0)
    radii_m: tuple[Positive, Positive] = (3.0, 2.0)
    # Where on the ellipse it starts, and how many laps it goes; negative: clockwise.
    start_rad: _Finite = 0.0
    laps: Annotated[float, Field(allow_inf_nan=False)] = 1.1
    # Where it looks: angle from the direction of travel to its x axis, about the vertical. [rad]
    look_rad: _Finite = -1.2
    # [m]
    height_m: Positive = 1.5
    # [m/s]
    speed_m_s: Positive = 0.7
    # When it starts. [s since the start of the simulation]
    start_s: NonNegative = 0.0


class SimulatedAgent(Section):
    """A robot in the simulated hall."""

    id: _AgentId
    reader: Literal["simulated"]
    walk: Walk = Walk()
    drift: Drift = Drift()
    keyframes: KeyframeSelectionConfig = KeyframeSelectionConfig()
    features: FeatureConfig = FeatureConfig()


class World(Section):
    """The simulated hall that all simulated agents share."""

    # Seed of everything in it.
    seed: Count = 0
    # Length, width, height. [m]
    size_m: tuple[Positive, Positive, Positive] = (14.0, 10.0, 4.0)
    # Box-shaped objects on the floor.
    num_objects: Count = 6
    # Landmarks per square metre of walls and objects; floor and ceiling have a third. [1/m^2]
    landmark_density: Positive = 100.0
    # Standard deviation of an observed position, per axis. [px]
    noise_px: NonNegative = 0.7
    # Share of an image's features that belong to nothing.
    clutter: Annotated[float, Field(ge=0, lt=1)] = 0.15
    # Images per second. [Hz]
    frame_rate_hz: Positive = 10.0


Agent = Annotated[TumAgent | SimulatedAgent, Field(discriminator="reader")]


class Scenario(Section):
    """A run to play: agents and settings."""

    # Name of the run; part of its folder's name and of the sessions of a lockstep run.
    name: Annotated[str, Field(min_length=1)]
    # Settings of the server and of the agents' uploads that differ from the defaults.
    config: Mapping[str, Any] = {}
    # The hall of the simulated agents.
    world: World = World()
    agents: Annotated[tuple[Agent, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> Scenario:
        ids = [agent.id for agent in self.agents]
        if len(set(ids)) != len(ids):
            raise ValueError("two agents have the same id")
        return self

    def agent(self, agent_id: str) -> TumAgent | SimulatedAgent:
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

    All agents of a recording, and all simulated ones, share the world frame.

    Args:
        scenario: The scenario that was played.
        agent_id: One of its agents.
        played: Folder in which the player left the ground truth of simulated agents.

    Raises:
        TrajectoryError: If a file is missing or malformed.
        ConfigError: If the calibration is.
    """
    agent = scenario.agent(agent_id)
    if isinstance(agent, SimulatedAgent):
        return read_tum(simulated_groundtruth_file(agent_id, played))
    return recorded_groundtruth(agent)


def recorded_groundtruth(agent: TumAgent) -> Trajectory | None:
    """`groundtruth` of an agent played from a recording."""
    if agent.groundtruth is None:
        return None
    return read_body_poses(agent, agent.groundtruth.file, agent.groundtruth.frame)


def read_body_poses(agent: TumAgent, file: Path, frame: PoseFrame) -> Trajectory:
    """Read poses of a recording's body or camera as ``T_ref_body``.

    Raises:
        TrajectoryError: If the file is missing or malformed.
        ConfigError: If the calibration, needed for poses of the camera, is.
    """
    read = read_tum(agent.path / file)
    if frame == "body":
        return read
    T_cam_body = frames.inverse(read_T_body_cam(agent.path / agent.camera))
    return Trajectory(read.stamps_ns, read.T_ref_body @ T_cam_body)


def simulated_groundtruth_file(agent_id: str, played: Path) -> Path:
    """Where the player leaves the ground truth of a simulated agent."""
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
