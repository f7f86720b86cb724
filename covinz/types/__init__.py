"""The values that travel between processes, as frozen dataclasses.

Conventions (docs/conventions.md): ``p_a = T_a_b @ p_b``; tangent order [rotation, translation],
right perturbation; time in nanoseconds since the Unix epoch; pixel (0, 0) is the centre of the
top-left pixel. `covinz.codec` is the only bridge between these types and the bytes of the wire.
"""

from __future__ import annotations

from covinz.types.identity import (
    AGENT_PATTERN,
    ULID_PATTERN,
    Array,
    KeyframeId,
    SegmentId,
    frozen_array,
)
from covinz.types.keyframe import (
    NUM_CAMERA_PARAMS,
    Camera,
    Features,
    FeatureType,
    Gap,
    Keyframe,
    KeyframeContent,
)
from covinz.types.log import LogEntry, LogHead, LogMark, LogPage, LogRange, LogView
from covinz.types.loop import (
    JobDone,
    JobPage,
    JobRange,
    JobRecord,
    JobState,
    Lease,
    LeaseRequest,
    LoopClosure,
    LoopJob,
    LoopPage,
    LoopRange,
    LoopSolution,
    MotionResidual,
    Outcome,
    Rejection,
    RigMember,
)
from covinz.types.map import Correction, MapList, MapSnapshot, MapSummary
from covinz.types.status import Status
from covinz.types.upload import Duplicate, NeedCamera, Rejected, RetryAfter, Stored, UploadReply

__all__ = [
    "AGENT_PATTERN",
    "NUM_CAMERA_PARAMS",
    "ULID_PATTERN",
    "Array",
    "Camera",
    "Correction",
    "Duplicate",
    "FeatureType",
    "Features",
    "Gap",
    "JobDone",
    "JobPage",
    "JobRange",
    "JobRecord",
    "JobState",
    "Keyframe",
    "KeyframeContent",
    "KeyframeId",
    "Lease",
    "LeaseRequest",
    "LogEntry",
    "LogHead",
    "LogMark",
    "LogPage",
    "LogRange",
    "LogView",
    "LoopClosure",
    "LoopJob",
    "LoopPage",
    "LoopRange",
    "LoopSolution",
    "MapList",
    "MapSnapshot",
    "MapSummary",
    "MotionResidual",
    "NeedCamera",
    "Outcome",
    "Rejected",
    "Rejection",
    "RetryAfter",
    "RigMember",
    "SegmentId",
    "Status",
    "Stored",
    "UploadReply",
    "frozen_array",
]
