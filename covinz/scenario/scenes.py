"""Generated worlds that rendered robots share, and how a visit to one looks."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from covinz.config import Count, NonNegative, Positive, Section

Share = Annotated[float, Field(ge=0, le=1)]


class HallScene(Section):
    """An industrial hall: walls, pillars, machines, shelves, hanging things."""

    kind: Literal["hall"]
    # Seed of everything in it.
    seed: Count = 0
    # Length, width, height; the floor is centred on the origin, z up. [m]
    size_m: tuple[Positive, Positive, Positive] = (20.0, 15.0, 8.0)


class CourtyardScene(Section):
    """Buildings around streets and courts under the sky."""

    kind: Literal["courtyard"]
    # Seed of everything in it.
    seed: Count = 0
    # Extent along x and y; centred on the origin, z up. [m]
    size_m: tuple[Positive, Positive] = (160.0, 110.0)


class MachineHallScene(Section):
    """A hall built around the paths that its robots fly, which are given."""

    kind: Literal["machine_hall"]
    # Seed of everything in it.
    seed: Count = 0
    # Nothing stands nearer than this to a path. [m]
    clearance_m: Positive = 1.0
    # Distance of the walls from the outermost path. [m]
    margin_m: Positive = 3.0


Scene = Annotated[HallScene | CourtyardScene | MachineHallScene, Field(discriminator="kind")]


class Look(Section):
    """What differs from one visit to the next: light, and what was moved or repainted."""

    # Which light: direction, warmth, brightness and shadows follow from it.
    light: Count = 0
    # Share of the surfaces that have another texture than in a visit with 0.
    changed: Share = 0.0
    # Seed of which surfaces those are and of their textures.
    seed: Count = 0


class Sensor(Section):
    """What the camera does to the light that falls into it."""

    # Shot noise: standard deviation at full white, of 255. [grey levels]
    shot_noise: NonNegative = 2.0
    # Read noise, everywhere. [grey levels]
    read_noise: NonNegative = 1.5
    # Loss of light in the corners.
    vignette: Share = 0.3
    # Auto-exposure aims at this mean. [grey levels]
    target_mean: Positive = 110.0
    # How far it is off, as the standard deviation of log2 of the exposure. [stops]
    exposure_lag: NonNegative = 0.15
    # Exposure time over which motion is blurred; 0: no blur. [s]
    blur_s: NonNegative = 0.0
