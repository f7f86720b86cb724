"""Robots played from recordings, and the true poses that come with them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from covinz import asl, frames
from covinz.calibration import read_T_body_cam
from covinz.config import Count, FeatureConfig, KeyframeSelectionConfig, Positive, Section
from covinz.scenario.odometry import DriftingGroundTruth, Odometry, PoseFrame
from covinz.trajectory import Trajectory, TrajectoryError, parse_stamp_ns, read_tum
from covinz.types import AGENT_PATTERN, Camera

AgentId = Annotated[str, Field(pattern=f"^{AGENT_PATTERN.pattern}$")]


class GroundTruthFile(Section):
    """Ground truth in a TUM trajectory file."""

    file: Path
    # Whose pose it is.
    frame: PoseFrame


class Recording(Section):
    """What the robots of all recordings have in common."""

    id: AgentId
    # Folder of the recording.
    path: Path
    # First and last time to use, in decimal seconds; as text, to keep nanoseconds.
    times_s: tuple[str, str] | None = None
    odometry: Odometry
    # An image between two poses further apart than this has no pose and is left out. [s]
    max_pose_gap_s: Positive = 0.1
    keyframes: KeyframeSelectionConfig = KeyframeSelectionConfig()
    features: FeatureConfig = FeatureConfig()

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        times = [parse_stamp_ns(text) for text in self.times_s or ()]
        if times != sorted(times):
            raise ValueError("the first time comes after the last")
        return self

    def in_time(self, stamp_ns: int) -> bool:
        """Whether a time belongs to the range to use; both ends do."""
        if self.times_s is None:
            return True
        first_ns, last_ns = (parse_stamp_ns(text) for text in self.times_s)
        return first_ns <= stamp_ns <= last_ns


class TumAgent(Recording):
    """A robot played from a recording in the layout of the TUM RGB-D data sets."""

    reader: Literal["tum"]
    # List of images: ``timestamp filename``.
    images: Path = Path("rgb.txt")
    # First and last frame to use. A frame's number is its file's name where all names are
    # integers, else its row in the list, from 0.
    frames: tuple[Count, Count] | None = None
    # Calibration: `calib.yaml` (see covinz.calibration) or TUM's `calib.txt`.
    camera: Path = Path("calib.yaml")
    groundtruth: GroundTruthFile | None = None

    @model_validator(mode="after")
    def _check(self) -> TumAgent:
        if self.frames is not None and self.times_s is not None:
            raise ValueError("give frames or times_s, not both")
        if self.frames is not None and self.frames[0] > self.frames[1]:
            raise ValueError("the first frame comes after the last")
        _require_truth(self.odometry, self.groundtruth)
        return self


class AslAgent(Recording):
    """A robot played from a recording in the ASL layout of EuRoC, TUM-VI and Kalibr.

    `path` is the folder that holds `mav0`.
    """

    reader: Literal["asl"]
    # Folder of the camera: `data.csv` and `data/`, or nothing but images named by their stamps.
    camera: Path = Path("mav0/cam0")
    # Calibration: ASL's `sensor.yaml`, by default the one in the folder of the camera, or
    # Kalibr's `camchain.yaml`, in which the camera has the name of its folder.
    calibration: Path | None = None
    # ``T_world_body``: a file of the layout (.csv), a TUM file, or null where there is none.
    groundtruth: Path | None = Path("mav0/state_groundtruth_estimate0/data.csv")

    @model_validator(mode="after")
    def _check(self) -> AslAgent:
        _require_truth(self.odometry, self.groundtruth)
        return self

    @property
    def calibration_file(self) -> Path:
        """Where the calibration is."""
        return self.path / (self.calibration or self.camera / "sensor.yaml")

    def read_camera(self) -> Camera:
        """The calibration; raises ConfigError as `covinz.asl.read_sensor`."""
        return asl.read_sensor(self.calibration_file, self.camera.name)


def _require_truth(odometry: Odometry, groundtruth: object) -> None:
    if isinstance(odometry, DriftingGroundTruth) and groundtruth is None:
        raise ValueError("odometry from drifting ground truth needs groundtruth")


def recorded_groundtruth(agent: TumAgent | AslAgent) -> Trajectory | None:
    """`groundtruth` of an agent played from a recording: ``T_world_body``.

    Raises:
        TrajectoryError: If the file is missing or malformed.
        ConfigError: If a calibration that is needed is.
    """
    if agent.groundtruth is None:
        return None
    if isinstance(agent, TumAgent):
        return read_body_poses(agent, agent.groundtruth.file, agent.groundtruth.frame)
    file = agent.path / agent.groundtruth
    if not file.exists():
        raise TrajectoryError(f"there is no {file}; groundtruth: null says that it is unknown")
    return asl.read_poses(file) if file.suffix == ".csv" else read_tum(file)


def read_body_poses(agent: TumAgent | AslAgent, file: Path, frame: PoseFrame) -> Trajectory:
    """Read poses of a recording's body or camera as ``T_ref_body``.

    Raises:
        TrajectoryError: If the file is missing or malformed.
        ConfigError: If the calibration, needed for poses of the camera, is.
    """
    read = read_tum(agent.path / file)
    if frame == "body":
        return read
    if isinstance(agent, TumAgent):
        T_body_cam = read_T_body_cam(agent.path / agent.camera)
    else:
        T_body_cam = agent.read_camera().T_body_cam
    return Trajectory(read.stamps_ns, read.T_ref_body @ frames.inverse(T_body_cam))
