"""Odometry of played robots: recorded, or true motion with seeded drift."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from covinz.config import Count, NonNegative, Section

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


Odometry = Annotated[FileOdometry | DriftingGroundTruth, Field(discriminator="source")]
