"""Robots played from recordings, and the true poses that come with them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from covinz import frames
from covinz.calibration import read_T_body_cam
from covinz.config import Count, FeatureConfig, KeyframeSelectionConfig, Positive, Section
from covinz.scenario.odometry import DriftingGroundTruth, Odometry, PoseFrame
from covinz.trajectory import Trajectory, parse_stamp_ns, read_tum
from covinz.types import AGENT_PATTERN

AgentId = Annotated[str, Field(pattern=f"^{AGENT_PATTERN.pattern}$")]


class GroundTruthFile(Section):
    """Ground truth in a TUM trajectory file."""

    file: Path
    # Whose pose it is.
    frame: PoseFrame


class TumAgent(Section):
    """A robot played from a recording in the layout of the TUM RGB-D data sets."""

    id: AgentId
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
    odometry: Odometry
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


class AslAgent(Section):
    """A robot played from a recording in the ASL layout of EuRoC, TUM-VI and Kalibr."""

    id: AgentId
    reader: Literal["asl"]
    # Folder of the recording: the one that holds `mav0`.
    path: Path
    # Folder of the camera: `data.csv`, `data/` and `sensor.yaml`.
    camera: Path = Path("mav0/cam0")
    # First and last time to use, in decimal seconds; as text, to keep nanoseconds.
    times_s: tuple[str, str] | None = None
    odometry: Odometry
    # ``T_world_body``: the ASL file, a TUM file, or None where there is none.
    groundtruth: Path | None = Path("mav0/state_groundtruth_estimate0/data.csv")
    # An image between two poses further apart than this has no pose and is left out. [s]
    max_pose_gap_s: Positive = 0.1
    keyframes: KeyframeSelectionConfig = KeyframeSelectionConfig()
    features: FeatureConfig = FeatureConfig()


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
