"""Robots that walk through a hall of landmarks; needs no data."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from covinz.config import (
    Count,
    FeatureConfig,
    KeyframeSelectionConfig,
    NonNegative,
    Positive,
    Section,
)
from covinz.scenario.odometry import Drift
from covinz.scenario.recordings import AgentId

Finite = Annotated[float, Field(allow_inf_nan=False)]


class Walk(Section):
    """Path of a simulated robot: laps of an ellipse through the hall, at a height that sways."""

    # Centre and half axes of the ellipse; the hall's floor is centred on the origin. [m]
    center_m: tuple[Finite, Finite] = (0.0, 0.0)
    radii_m: tuple[Positive, Positive] = (3.0, 2.0)
    # Where on the ellipse it starts, and how many laps it goes; negative: clockwise.
    start_rad: Finite = 0.0
    laps: Finite = 1.1
    # Where it looks: angle from the direction of travel to its x axis, about the vertical. [rad]
    look_rad: Finite = -1.2
    # [m]
    height_m: Positive = 1.5
    # [m/s]
    speed_m_s: Positive = 0.7
    # When it starts. [s since the start of the simulation]
    start_s: NonNegative = 0.0


class SimulatedAgent(Section):
    """A robot in the simulated hall."""

    id: AgentId
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
