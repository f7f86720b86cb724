"""The values that travel between processes, as frozen dataclasses.

Conventions (docs/conventions.md): ``p_a = T_a_b @ p_b``; tangent order [rotation, translation],
right perturbation; time in nanoseconds since the Unix epoch; pixel (0, 0) is the centre of the
top-left pixel. `covinz.codec` is the only bridge between these types and the bytes of the wire.
"""

from __future__ import annotations

import enum
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AGENT_PATTERN = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
ULID_PATTERN = re.compile(r"[0-7][0-9A-HJKMNP-TV-Z]{25}")
_SEQ_PATTERN = re.compile(r"0|[1-9][0-9]{0,18}")


def frozen_array(
    values: object, shape: tuple[int | None, ...], dtype: str = "f8"
) -> NDArray[np.generic]:
    """Return a read-only, C-contiguous copy of `values` after checking its shape.

    Args:
        values: Anything that numpy makes an array of.
        shape: Wanted shape; None accepts any length of that axis.
        dtype: Wanted element type.

    Raises:
        ValueError: If the shape differs, or an integer or boolean array cannot hold the values.
    """
    source = np.asarray(values)
    with np.errstate(invalid="ignore", over="ignore"):
        array = source.astype(dtype, order="C", copy=True)
    if array.dtype.kind in "iub" and source.dtype != array.dtype and np.any(array != source):
        raise ValueError(f"not all values are {array.dtype}")
    if array.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        raise ValueError(f"expected an array of shape {shape}, got {array.shape}")
    array.setflags(write=False)
    return array


@dataclass(frozen=True, slots=True, order=True)
class KeyframeId:
    """Names one keyframe for ever.

    Attributes:
        agent: Robot, matches ``[a-z0-9][a-z0-9_-]{0,31}``.
        session: ULID of one uninterrupted run of the robot's odometry.
        seq: Counts the keyframes of the session from 0 without gaps.
    """

    agent: str
    session: str
    seq: int

    def __str__(self) -> str:
        return f"{self.agent}/{self.session}/{self.seq}"

    @property
    def segment(self) -> SegmentId:
        """The segment this keyframe belongs to."""
        return SegmentId(self.agent, self.session)

    @classmethod
    def parse(cls, text: str) -> KeyframeId:
        """Read ``agent/session/seq``; raises ValueError when `text` is anything else."""
        agent, session, seq = text.split("/") if text.count("/") == 2 else ("", "", "")
        well_formed = AGENT_PATTERN.fullmatch(agent) and ULID_PATTERN.fullmatch(session)
        if not (well_formed and _SEQ_PATTERN.fullmatch(seq) and int(seq) < 2**63):
            raise ValueError(f"not a keyframe id: {text!r}")
        return cls(agent, session, int(seq))


@dataclass(frozen=True, slots=True, order=True)
class SegmentId:
    """One agent's keyframes of one session: what odometry alone holds together."""

    agent: str
    session: str

    def __str__(self) -> str:
        return f"{self.agent}/{self.session}"


class FeatureType(enum.Enum):
    """Kind of local feature; the value is the length of one descriptor in bytes."""

    ORB = 32
    SIFT = 128

    @property
    def descriptor_bytes(self) -> int:
        """Length of one descriptor."""
        return int(self.value)


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A calibrated camera on a robot.

    Attributes:
        model: COLMAP name: PINHOLE, OPENCV, FULL_OPENCV or OPENCV_FISHEYE.
        width: Image width in pixels.
        height: Image height in pixels.
        params: Intrinsics in COLMAP's order for the model.
        T_body_cam: (4, 4) pose of the camera (x right, y down, z forward) in the body frame.
    """

    model: str
    width: int
    height: int
    params: Array
    T_body_cam: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "params", frozen_array(self.params, (None,)))
        object.__setattr__(self, "T_body_cam", frozen_array(self.T_body_cam, (4, 4)))

    @property
    def hash(self) -> str:
        """Content hash (16 hex digits) under which the calibration is registered once."""
        digest = hashlib.blake2b(digest_size=8)
        digest.update(f"{self.model} {self.width} {self.height}\n".encode())
        digest.update(self.params.astype("<f8").tobytes())
        digest.update(self.T_body_cam.astype("<f8").tobytes())
        return digest.hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """The local features of one image.

    Attributes:
        type: Kind of feature.
        keypoints_px: (N, 2) float32 raw (distorted) pixel positions x, y.
        descriptors: (N, type.descriptor_bytes) uint8.
    """

    type: FeatureType
    keypoints_px: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def __post_init__(self) -> None:
        n = len(self.keypoints_px)
        object.__setattr__(self, "keypoints_px", frozen_array(self.keypoints_px, (n, 2), "f4"))
        shape = (n, self.type.descriptor_bytes)
        object.__setattr__(self, "descriptors", frozen_array(self.descriptors, shape, "u1"))

    def __len__(self) -> int:
        return len(self.keypoints_px)


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeContent:
    """What a front-end measures for one keyframe, before the agent gives it an id.

    Attributes:
        stamp_ns: Time of exposure.
        T_odom_body: (4, 4) odometry pose; never changed afterwards.
        camera: Calibration of the image.
        features: Local features of the image.
        covariance: Optional (6, 6) covariance of the motion since the previous keyframe: right
            perturbation [rotation (rad), translation (m)] of ``T_prev_cur``, in the current body
            frame.
        gravity_body: Optional (3,) unit direction of gravity in the body frame.
        thumbnail_jpeg: Optional small picture for viewers.
    """

    stamp_ns: int
    T_odom_body: Array
    camera: Camera
    features: Features
    covariance: Array | None = None
    gravity_body: Array | None = None
    thumbnail_jpeg: bytes | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A keyframe as it is logged; fields as in `KeyframeContent`.

    `features` is None in the log's ``pose`` view, which leaves them out.
    """

    id: KeyframeId
    stamp_ns: int
    T_odom_body: Array
    camera_hash: str
    features: Features | None
    covariance: Array | None = None
    gravity_body: Array | None = None
    thumbnail_jpeg: bytes | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_odom_body", frozen_array(self.T_odom_body, (4, 4)))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", frozen_array(self.covariance, (6, 6)))
        if self.gravity_body is not None:
            object.__setattr__(self, "gravity_body", frozen_array(self.gravity_body, (3,)))


@dataclass(frozen=True, slots=True)
class Gap:
    """A range of a session's keyframes that its agent had to drop; durable like a keyframe."""

    agent: str
    session: str
    first_seq: int
    last_seq: int
    reason: str


# --- answers of ingest to an upload ---------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Stored:
    """The upload is durable."""


@dataclass(frozen=True, slots=True)
class Duplicate:
    """The same upload was durable already; for the agent as good as Stored."""


@dataclass(frozen=True, slots=True)
class RetryAfter:
    """Overloaded or not ready: send again after `seconds`."""

    seconds: float
    reason: str


@dataclass(frozen=True, slots=True)
class NeedCamera:
    """The keyframe names a calibration that is not registered: send it, then send again."""

    camera_hash: str


@dataclass(frozen=True, slots=True)
class Rejected:
    """The upload can never be accepted; the only final refusal.

    Attributes:
        code: Short snake_case name of the check that failed, e.g. ``foreign_agent``.
        reason: What was wrong, for a person.
    """

    code: str
    reason: str


UploadReply = Stored | Duplicate | RetryAfter | NeedCamera | Rejected


# --- the keyframe log -----------------------------------------------------------------------


class LogView(enum.Enum):
    """How much of a keyframe a reader of the log is sent."""

    POSE = "pose"
    FULL = "full"


@dataclass(frozen=True, slots=True)
class LogRange:
    """Asks ingest for log entries from `start` on; the answer is one LogPage of bounded size."""

    start: int
    view: LogView


@dataclass(frozen=True, slots=True, eq=False)
class LogEntry:
    """One row of the keyframe log: a keyframe or a declared gap."""

    log_index: int
    item: Keyframe | Gap


@dataclass(frozen=True, slots=True, eq=False)
class LogPage:
    """A run of consecutive log entries.

    Attributes:
        log_id: ULID of the log; another one means another history: rebuild.
        head: Number of entries in the log, i.e. the next log_index to be given.
        entries: Consecutive entries from the asked index on; empty at the head.
    """

    log_id: str
    head: int
    entries: tuple[LogEntry, ...]


@dataclass(frozen=True, slots=True)
class LogHead:
    """Wake-up call of ingest: the log has grown to `head` entries."""

    log_id: str
    head: int


# --- loops ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class RigMember:
    """One camera of a rig: a keyframe, its odometry pose and its calibration."""

    keyframe: KeyframeId
    T_odom_body: Array
    camera_hash: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_odom_body", frozen_array(self.T_odom_body, (4, 4)))


@dataclass(frozen=True, slots=True, eq=False)
class LoopJob:
    """A candidate pair to verify; self-contained and fixed when it is created.

    Attributes:
        id: 32 hex digits: hash of query, candidate, solver configuration and vocabulary.
        query_rig: S_q of the paper; the first member is the query keyframe.
        cand_rig: S_c of the paper; the first member is the candidate keyframe.
        score: Place-recognition score of the candidate.
        seed: Seed of every random draw: the first 8 bytes of the id.
    """

    id: str
    query_rig: tuple[RigMember, ...]
    cand_rig: tuple[RigMember, ...]
    score: float

    @property
    def query(self) -> KeyframeId:
        """The keyframe whose arrival triggered the search."""
        return self.query_rig[0].keyframe

    @property
    def cand(self) -> KeyframeId:
        """The earlier keyframe it may have seen the same place as."""
        return self.cand_rig[0].keyframe

    @property
    def seed(self) -> int:
        """Seed of every random draw of the job."""
        return int(self.id[:16], 16)


@dataclass(frozen=True, slots=True, eq=False)
class LoopClosure:
    """A verified loop.

    Attributes:
        job_id: The job it is the outcome of; the receiver deduplicates by it.
        query: The keyframe whose arrival triggered the search.
        cand: The keyframe it was matched to, perhaps of another agent.
        T_cand_query: (4, 4) metric relative pose of the two bodies; the paper's T_cq.
        covariance: (6, 6) of its right perturbation [rotation (rad), translation (m)], in the
            query body frame.
        num_inliers: Inliers of the 17-point RANSAC.
        num_matches: Descriptor matches of all pairs together.
        solver_ms: Time of the numeric core for this job.
    """

    job_id: str
    query: KeyframeId
    cand: KeyframeId
    T_cand_query: Array
    covariance: Array
    num_inliers: int
    num_matches: int
    solver_ms: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_cand_query", frozen_array(self.T_cand_query, (4, 4)))
        object.__setattr__(self, "covariance", frozen_array(self.covariance, (6, 6)))


@dataclass(frozen=True, slots=True)
class Rejection:
    """Why there is no loop here.

    Attributes:
        job_id: The job it is the outcome of.
        query: As in LoopClosure.
        cand: As in LoopClosure.
        stage: The check that failed, e.g. ``pair_inliers``; ``dead_letter`` after too many
            failed attempts.
        count: What was counted or measured at that stage.
        threshold: What would have been enough.
        detail: More for a person, e.g. which pair; may be empty.
        solver_ms: Time of the numeric core for this job.
    """

    job_id: str
    query: KeyframeId
    cand: KeyframeId
    stage: str
    count: float
    threshold: float
    detail: str
    solver_ms: float


Outcome = LoopClosure | Rejection


@dataclass(frozen=True, slots=True)
class LeaseRequest:
    """A worker asks for a job; the dispatcher may hold the answer until there is one."""

    worker: str


@dataclass(frozen=True, slots=True, eq=False)
class Lease:
    """A job lent to a worker.

    Attributes:
        job: The job.
        worker: Who holds it.
        attempt: 1 for the first lease of the job.
        duration_s: The lease ends this long after it was given.
    """

    job: LoopJob
    worker: str
    attempt: int
    duration_s: float


@dataclass(frozen=True, slots=True, eq=False)
class JobDone:
    """A worker returns the outcome of a job; accepted whatever became of its lease."""

    worker: str
    outcome: Outcome


class JobState(enum.Enum):
    """Where a job is in its life."""

    PENDING = "pending"
    LEASED = "leased"
    DONE = "done"
    DEAD = "dead"


@dataclass(frozen=True, slots=True, eq=False)
class JobRecord:
    """A job as the dispatcher knows it, for "why was there no loop here?"."""

    job: LoopJob
    state: JobState
    attempts: int
    outcome: Outcome | None


@dataclass(frozen=True, slots=True)
class JobRange:
    """Asks the dispatcher for job records from number `first` on; the answer is a JobPage."""

    first: int


@dataclass(frozen=True, slots=True, eq=False)
class JobPage:
    """A run of job records in order of creation; `total` is the number of all jobs."""

    total: int
    first: int
    records: tuple[JobRecord, ...]


# --- maps -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Where a robot's odometry frame is in the shared map.

    Attributes:
        keyframe: The newest optimised keyframe of the segment; the correction is exact there.
        map_id: Session ULID of the map's oldest segment.
        map_revision: Grows with every optimisation of the map.
        T_map_odom: (4, 4), REP-105's map -> odom.
        jumped: The correction moved further than a controller should follow blindly since the
            last one, or names another map.
        stamp_ns: When it was made.
    """

    keyframe: KeyframeId
    map_id: str
    map_revision: int
    T_map_odom: Array
    jumped: bool
    stamp_ns: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_map_odom", frozen_array(self.T_map_odom, (4, 4)))


@dataclass(frozen=True, slots=True)
class MapSummary:
    """One map in a list of maps; `segments` from the oldest on (its odom frame is the map's)."""

    map_id: str
    revision: int
    segments: tuple[SegmentId, ...]
    num_keyframes: int
    num_loops: int


@dataclass(frozen=True, slots=True)
class MapList:
    """All maps, oldest first."""

    maps: tuple[MapSummary, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MapSnapshot:
    """One map as it stands: nodes and edges of its pose graph.

    Attributes:
        summary: Identity and size.
        keyframes: (N) ids in log order.
        stamps_ns: (N,) int64.
        T_map_body: (N, 4, 4) optimised poses.
        T_odom_body: (N, 4, 4) poses as the agents sent them, each in its own odom frame.
        edge_from: (M,) int64 index into keyframes.
        edge_to: (M,) int64 index into keyframes.
        T_from_to: (M, 4, 4) measured relative poses.
        information: (M, 6, 6) of the right perturbation [rotation, translation].
        is_loop: (M,) bool; the others are odometry edges.
    """

    summary: MapSummary
    keyframes: tuple[KeyframeId, ...]
    stamps_ns: NDArray[np.int64]
    T_map_body: Array
    T_odom_body: Array
    edge_from: NDArray[np.int64]
    edge_to: NDArray[np.int64]
    T_from_to: Array
    information: Array
    is_loop: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n, m = len(self.keyframes), len(self.edge_from)
        for name, shape, dtype in (
            ("stamps_ns", (n,), "i8"),
            ("T_map_body", (n, 4, 4), "f8"),
            ("T_odom_body", (n, 4, 4), "f8"),
            ("edge_from", (m,), "i8"),
            ("edge_to", (m,), "i8"),
            ("T_from_to", (m, 4, 4), "f8"),
            ("information", (m, 6, 6), "f8"),
            ("is_loop", (m,), "?"),
        ):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, dtype))


# --- status ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Status:
    """What a process answers when asked how far it is.

    The system is idle when every cursor is at the head of the log, no job is pending or leased
    and nothing is dirty.

    Attributes:
        service: Name of the process, e.g. ``ingest``.
        instance: Which one of several.
        log_id: Log it follows or owns; empty when it has none.
        cursor: Next log index it will process (for ingest: the head of the log).
        pending: Jobs or events that wait.
        leased: Jobs lent out.
        dirty: Something accepted is not yet reflected in what the process publishes.
        counters: Further numbers by name.
    """

    service: str
    instance: str
    log_id: str
    cursor: int
    pending: int
    leased: int
    dirty: bool
    counters: Mapping[str, float] = field(default_factory=dict)
