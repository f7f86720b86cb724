"""Odometry of played robots: recorded, or true motion with seeded drift."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from covinz.config import Count, NonNegative, Section

PoseFrame = Literal["body", "camera"]


class Drift(Section):
    """Random walk added to true motion, so that it drifts like odometry; zero adds nothing.

    The sigmas are per axis, after one metre or one radian; variances add up, so that after 100 m
    they are ten times those after one. The defaults are good visual-inertial odometry.
    """

    # Rotation per square root of metre travelled: 0.1 degrees. [rad / sqrt(m)]
    rotation_per_sqrt_m: NonNegative = 0.001745
    # Rotation per square root of radian turned: 0.1 degrees, a scale error of 0.2 %, as gyroscopes
    # of this class have. [rad / sqrt(rad)]
    rotation_per_sqrt_rad: NonNegative = 0.001745
    # Translation per square root of metre travelled: 1 %. [m / sqrt(m)]
    translation_per_sqrt_m: NonNegative = 0.01
    # Translation per square root of radian turned: what a lever of 0.5 m from body to camera makes
    # of the same error. [m / sqrt(rad)]
    translation_per_sqrt_rad: NonNegative = 0.001
    # Seed of the random walk, with that of the scenario; agents with the same seed still drift
    # differently.
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
