"""Robots whose images are rendered in a generated world: exact ground truth, no data needed."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

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
from covinz.trajectory import parse_stamp_ns

Finite = Annotated[float, Field(allow_inf_nan=False)]

# A 79 degree lens with the distortion of EuRoC's cameras; x of the body is ahead, z up.
WIDE_LENS = CalibrationFile(
    model="OPENCV",
    width=752,
    height=480,
    params=(458.0, 457.0, 367.0, 248.0, -0.283, 0.074, 2e-4, 2e-5),
    T_body_cam=(0, 0, 1, 0.1, -1, 0, 0, 0.03, 0, -1, 0, 0.05, 0, 0, 0, 1),
    # A rendered image is of its stamp's moment.
    readout_s=0.0,
)


class SmoothPath(Section):
    """A seeded smooth path through the free space of the world."""

    kind: Literal["smooth"]
    # Seed of the path, with that of the scenario; robots with the same seed go different ways.
    seed: Count = 0
    # [m]
    length_m: Positive = 60.0
    # Lowest and highest. [m]
    height_m: tuple[Positive, Positive] = (1.2, 2.5)
    # Nothing is nearer to the body than this, so nothing that the camera sees along its axis. [m]
    min_depth_m: Positive = 1.0
    # Where it looks: angle from the direction of travel, about the vertical. [rad]
    look_rad: Finite = -1.2
    # [m/s]
    speed_m_s: Positive = 0.8
    # When it starts. [s since the start of the scenario]
    start_s: NonNegative = 0.0


class WaypointPath(Section):
    """A smooth path through given points; nobody checks that nothing is in its way."""

    kind: Literal["waypoints"]
    # x, y, z in the world. [m]
    points_m: Annotated[tuple[tuple[Finite, Finite, Finite], ...], Field(min_length=2)]
    # Back to the first point at the end, ...
    closed: bool = False
    # ... and then on, so many times around.
    laps: Positive = 1.0
    # Where it looks: angle from the direction of travel, about the vertical. [rad]
    look_rad: Finite = 0.0
    # [m/s]
    speed_m_s: Positive = 1.2
    # When it starts. [s since the start of the scenario]
    start_s: NonNegative = 0.0

    @model_validator(mode="after")
    def _check(self) -> WaypointPath:
        if self.laps != 1.0 and not self.closed:
            raise ValueError("laps are for closed paths")
        ring = [*self.points_m, *self.points_m[: 1 if self.closed else 0]]
        if any(a == b for a, b in itertools.pairwise(ring)):
            raise ValueError("two neighbouring points are the same")
        return self


class FilePath(Section):
    """A trajectory ``T_world_body`` from a TUM file, e.g. the ground truth of a flight."""

    kind: Literal["file"]
    file: Path
    # First and last time to use, in decimal seconds; as text, to keep nanoseconds.
    times_s: tuple[str, str] | None = None

    @model_validator(mode="after")
    def _check(self) -> FilePath:
        times = [parse_stamp_ns(text) for text in self.times_s or ()]
        if times != sorted(times):
            raise ValueError("the first time comes after the last")
        return self


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
    # The robot measures gravity with this error, per axis; null: it does not. [rad]
    gravity_sigma_rad: NonNegative | None = None
    # Images per second from which keyframes are chosen; only those are rendered. [Hz]
    frame_rate_hz: Positive = 10.0
    # An image between two poses of a file further apart than this is left out. [s]
    max_pose_gap_s: Positive = 0.2
    keyframes: KeyframeSelectionConfig = KeyframeSelectionConfig()
    features: FeatureConfig = FeatureConfig()
