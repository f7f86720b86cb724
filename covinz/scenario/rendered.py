"""Robots whose images are rendered in a generated world: exact ground truth, no data needed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from covinz.calibration import CalibrationFile
from covinz.config import (
    Count,
    FeatureConfig,
    KeyframeSelectionConfig,
    NonNegative,
    Positive,
    Section,
)
from covinz.scenario.odometry import DriftingGroundTruth, Odometry
from covinz.scenario.recordings import AgentId
from covinz.scenario.scenes import Look, Sensor

Finite = Annotated[float, Field(allow_inf_nan=False)]

# A 79 degree lens with the distortion of EuRoC's cameras; x of the body is ahead, z up.
WIDE_LENS = CalibrationFile(
    model="OPENCV",
    width=752,
    height=480,
    params=(458.0, 457.0, 367.0, 248.0, -0.283, 0.074, 2e-4, 2e-5),
    T_body_cam=(0, 0, 1, 0.1, -1, 0, 0, 0.03, 0, -1, 0, 0.05, 0, 0, 0, 1),
)


class SmoothPath(Section):
    """A seeded smooth path through the free space of the world."""

    kind: Literal["smooth"]
    # Seed of the path; with the scenario's seed and the agent's id.
    seed: Count = 0
    # [m]
    length_m: Positive = 60.0
    # Lowest and highest. [m]
    height_m: tuple[Positive, Positive] = (1.2, 2.5)
    # Nothing that the camera sees along its axis, and nothing at all, is nearer than this. [m]
    min_depth_m: Positive = 1.0
    # Where it looks: angle from the direction of travel, about the vertical. [rad]
    look_rad: Finite = -1.2
    # [m/s]
    speed_m_s: Positive = 0.8
    # When it starts. [s since the start of the scenario]
    start_s: NonNegative = 0.0


class WaypointPath(Section):
    """A smooth path through given points."""

    kind: Literal["waypoints"]
    # x, y, z in the world. [m]
    points_m: Annotated[tuple[tuple[Finite, Finite, Finite], ...], Field(min_length=2)]
    # Back to the first point at the end.
    closed: bool = False
    laps: Positive = 1.0
    look_rad: Finite = 0.0
    # [m/s]
    speed_m_s: Positive = 1.2
    start_s: NonNegative = 0.0


class FilePath(Section):
    """A trajectory ``T_world_body`` from a TUM file, e.g. the ground truth of a flight."""

    kind: Literal["file"]
    file: Path
    # First and last time to use, in decimal seconds; as text, to keep nanoseconds.
    times_s: tuple[str, str] | None = None


RenderedPath = Annotated[SmoothPath | WaypointPath | FilePath, Field(discriminator="kind")]


class RenderedAgent(Section):
    """A robot whose camera images are rendered."""

    id: AgentId
    reader: Literal["rendered"]
    path: RenderedPath = SmoothPath(kind="smooth")
    look: Look = Look()
    camera: CalibrationFile = WIDE_LENS
    sensor: Sensor = Sensor()
    odometry: Odometry = DriftingGroundTruth(source="groundtruth_drift")
    # Images per second from which keyframes are chosen; only those are rendered. [Hz]
    frame_rate_hz: Positive = 10.0
    keyframes: KeyframeSelectionConfig = KeyframeSelectionConfig()
    features: FeatureConfig = FeatureConfig()
