"""Scenarios: which robots to play, from what, and with what settings of the server."""

from covinz.scenario.odometry import Drift, DriftingGroundTruth, FileOdometry, Odometry, PoseFrame
from covinz.scenario.recordings import (
    AslAgent,
    GroundTruthFile,
    TumAgent,
    read_body_poses,
    recorded_groundtruth,
)
from covinz.scenario.rendered import (
    FilePath,
    RenderedAgent,
    RenderedPath,
    SmoothPath,
    WaypointPath,
)
from covinz.scenario.scenario import (
    Agent,
    Scenario,
    generated_groundtruth_file,
    groundtruth,
    load_scenario,
)
from covinz.scenario.scenes import (
    CourtyardScene,
    HallScene,
    Look,
    MachineHallScene,
    Scene,
    Sensor,
)

__all__ = [
    "Agent",
    "AslAgent",
    "CourtyardScene",
    "Drift",
    "DriftingGroundTruth",
    "FileOdometry",
    "FilePath",
    "GroundTruthFile",
    "HallScene",
    "Look",
    "MachineHallScene",
    "Odometry",
    "PoseFrame",
    "RenderedAgent",
    "RenderedPath",
    "Scenario",
    "Scene",
    "Sensor",
    "SmoothPath",
    "TumAgent",
    "WaypointPath",
    "generated_groundtruth_file",
    "groundtruth",
    "load_scenario",
    "read_body_poses",
    "recorded_groundtruth",
]
