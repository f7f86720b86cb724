"""One fixed value of every message, and equality of messages: what the golden bytes stand for."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covinz import types
from covinz.types import KeyframeId, SegmentId

OLD, NEW = "01ARZ3NDEKTSV4RRFFQ69G5FAV", "01BX5ZZKBKACTAV9WEVGEMMVRZ"
HASH = "00112233aabbccdd"
JOB = "0123456789abcdef0123456789abcdef"


def quarter_turn(x: float, y: float, z: float) -> NDArray[np.float64]:
    """Pose at x, y, z, turned by 90 degrees about z: exact in a matrix, not in a quaternion."""
    return np.array([[0, -1, 0, x], [1, 0, 0, y], [0, 0, 1, z], [0, 0, 0, 1]], dtype=float)


def turn(x: float, y: float, z: float) -> NDArray[np.float64]:
    """Pose at x, y, z, turned by 120 degrees about (1, 1, 1): its quaternion is all 1/2."""
    return np.array([[0, 0, 1, x], [1, 0, 0, y], [0, 1, 0, z], [0, 0, 0, 1]], dtype=float)


QUERY, CAND = KeyframeId("robot-2", NEW, 41), KeyframeId("robot_1", OLD, 7)
COVARIANCE = np.diag([1e-4, 2e-4, 3e-4, 1e-2, 2e-2, 3e-2]) + 1e-5
ORB = types.Features(
    types.FeatureType.ORB,
    np.array([[0, 0.0625], [319.5, 239.5], [4095.9375, 1]], dtype=np.float32),
    np.arange(96, dtype=np.uint8).reshape(3, 32),
)
SIFT = types.Features(
    types.FeatureType.SIFT,
    np.array([[12.25, 34.75]], dtype=np.float32),
    np.arange(128, dtype=np.uint8)[None] * 2,
)
KEYFRAME = types.Keyframe(
    QUERY, 1_700_000_000_123_456_789, turn(1, -2, 0.5), HASH, ORB, COVARIANCE,
    np.array([0, 0.6, -0.8]), b"\xff\xd8\xff\xe0 picture",
)  # fmt: skip
GAP = types.Gap("robot_1", OLD, 3, 9, "spool over 1 GiB \N{EM DASH} oldest dropped")
LOOP = types.LoopClosure(JOB, QUERY, CAND, turn(0.25, 0, -1), COVARIANCE, 142, 611, 17.5)
FAST_LOOP = dataclasses.replace(
    LOOP,
    motion_residuals=(
        types.MotionResidual(
            CAND, dataclasses.replace(CAND, seq=CAND.seq + 1), np.linspace(-1, 1.5, 6)
        ),
    ),
)
REJECTION = types.Rejection(JOB, QUERY, CAND, "pair_inliers", 21.0, 30.0, "pair 1-2", 4.25)
AMBIGUOUS = types.Rejection(
    *(JOB, QUERY, CAND, "ambiguous", 1.5, 3.0, "two solutions", 4.25),
    solutions=(
        types.LoopSolution(turn(0.25, 0, -1), COVARIANCE, 142, 611.5),
        types.LoopSolution(turn(0.5, 0.25, -1), COVARIANCE, 139, 618.25),
    ),
)
LOOP_JOB = types.LoopJob(
    JOB,
    tuple(types.RigMember(QUERY, turn(i, 0, 0), HASH) for i in range(2)),
    tuple(types.RigMember(CAND, turn(0, i, 0), HASH) for i in range(3)),
    38.25,
)
RIG_MOTION_JOB = dataclasses.replace(
    LOOP_JOB,
    query_rig=(
        dataclasses.replace(LOOP_JOB.query_rig[0], motion_covariance=COVARIANCE),
        *LOOP_JOB.query_rig[1:],
    ),
)
RIG_TWISTS_JOB = dataclasses.replace(
    RIG_MOTION_JOB,
    cand_rig=tuple(
        dataclasses.replace(member, twists=np.arange(12.0).reshape(2, 6) / 8)
        for member in LOOP_JOB.cand_rig
    ),
)
SUMMARY = types.MapSummary(
    OLD, 12, (SegmentId("robot_1", OLD), SegmentId("robot-2", NEW)), 3, 1
)  # fmt: skip
SNAPSHOT = types.MapSnapshot(
    summary=SUMMARY,
    keyframes=(CAND, KeyframeId("robot_1", OLD, 8), QUERY),
    stamps_ns=np.array([10, 20, 30]),
    T_map_body=np.stack([turn(i, 0, 0) for i in range(3)]),
    T_odom_body=np.stack([turn(0, i, 0) for i in range(3)]),
    edge_from=np.array([0, 0]),
    edge_to=np.array([1, 2]),
    T_from_to=np.stack([turn(0, 0, i) for i in range(2)]),
    information=np.stack([np.eye(6) * 100, np.diag([1.0, 2, 3, 4, 5, 6]) + 0.5]),
    is_loop=np.array([False, True]),
)

EXAMPLES: dict[str, Any] = {
    "Camera": types.Camera(
        "OPENCV", 640, 480, np.array([525, 526, 319.5, 239.5, 0.1, -0.2, 0.001, 0]),
        quarter_turn(0.05, 0, 0.1),
    ),
    "Camera-readout": types.Camera(
        "PINHOLE", 640, 480, np.array([525, 526, 319.5, 239.5]), quarter_turn(0, 0, 0), 0.0
    ),
    "Keyframe": KEYFRAME,
    "Keyframe-sift": types.Keyframe(CAND, 0, turn(0, 0, 0), HASH, SIFT),
    "Keyframe-two_kinds": types.Keyframe(
        CAND, 0, turn(0, 0, 0), HASH, ORB, more_features=(SIFT,)
    ),
    "Keyframe-pose": types.Keyframe(CAND, 5, turn(0, 0, 0), HASH, None),
    "Gap": GAP,
    "UploadReply-stored": types.Stored(),
    "UploadReply-duplicate": types.Duplicate(),
    "UploadReply-retry_after": types.RetryAfter(0.5, "inbox full"),
    "UploadReply-need_camera": types.NeedCamera(HASH),
    "UploadReply-rejected": types.Rejected("foreign_agent", "the key is another agent's"),
    "LogRange": types.LogRange(17, types.LogView.POSE),
    "LogRange-of_a_log": types.LogRange(17, types.LogView.FULL, OLD, "0123456789abcdef" * 2),
    "LogPage": types.LogPage(OLD, 19, (types.LogEntry(17, KEYFRAME), types.LogEntry(18, GAP))),
    "LogPage-empty": types.LogPage(OLD, 19, ()),
    "LogPage-chain": types.LogPage(OLD, 18, (types.LogEntry(17, GAP),), "0123456789abcdef" * 2),
    "LogHead": types.LogHead(OLD, 2**40),
    "LeaseRequest": types.LeaseRequest("worker-1"),
    "Lease": types.Lease(LOOP_JOB, "worker-1", 2, 60.0),
    "Lease-of_a_log": types.Lease(LOOP_JOB, "worker-1", 2, 60.0, NEW),
    "LoopJob": LOOP_JOB,
    "LoopJob-motions": RIG_MOTION_JOB,
    "LoopJob-twists": RIG_TWISTS_JOB,
    "LoopClosure": LOOP,
    "LoopClosure-fast": FAST_LOOP,
    "LoopClosure-of_a_log": dataclasses.replace(LOOP, log_id=NEW),
    "Rejection": REJECTION,
    "Rejection-ambiguous": AMBIGUOUS,
    "JobDone-loop": types.JobDone("worker-1", LOOP),
    "JobDone-rejection": types.JobDone("worker-1", REJECTION),
    "JobDone-of_a_log": types.JobDone("worker-1", REJECTION, NEW),
    "JobDone-wants_next": types.JobDone("worker-1", REJECTION, NEW, wants_next=True),
    "JobRange": types.JobRange(100),
    "JobPage": types.JobPage(
        2, 0,
        (
            types.JobRecord(LOOP_JOB, types.JobState.PENDING, 0, None),
            types.JobRecord(LOOP_JOB, types.JobState.DONE, 1, LOOP),
        ),
    ),
    "LoopRange": types.LoopRange(JOB),
    "LoopRange-all": types.LoopRange(),
    "LoopPage": types.LoopPage(OLD, (LOOP, FAST_LOOP)),
    "LoopPage-empty": types.LoopPage("", ()),
    "Correction": types.Correction(QUERY, OLD, 12, turn(3, 2, 1), True, 1_700_000_000_000_000_000),
    "MapList": types.MapList((SUMMARY,)),
    "MapSnapshot": SNAPSHOT,
    "Status": types.Status("ingest", "main", OLD, 19, 1, 0, True, {"bytes": 1.5, "agents": 3.0}),
    "Status-version": types.Status(
        "ingest", "main", OLD, 1, 0, 0, False, {}, "0.1.0+messages.01234567", 10**18
    ),
    "Status-idle": types.Status("router", "main", "", 0, 0, 0, False),
}  # fmt: skip


def kind_of(message: Any) -> Any:
    """What to decode the message as: its type, or None for one of ingest's replies."""
    replies = (types.Stored, types.Duplicate, types.RetryAfter, types.NeedCamera, types.Rejected)
    return None if isinstance(message, replies) else type(message)


def same(a: Any, b: Any, rotation_tolerance: float = 0.0) -> bool:
    """Whether two values are equal, arrays included.

    Equal means to the last bit, but for the entries of the rotations (the upper left 3x3 of arrays
    of shape (..., 4, 4)), which may differ by `rotation_tolerance`.
    """
    if type(a) is not type(b):
        return False
    inner = functools.partial(same, rotation_tolerance=rotation_tolerance)
    if dataclasses.is_dataclass(a):
        names = [field.name for field in dataclasses.fields(a)]
        return all(inner(getattr(a, name), getattr(b, name)) for name in names)
    if isinstance(a, np.ndarray):
        if a.dtype != b.dtype or a.shape[-2:] != (4, 4) or a.shape != b.shape:
            return a.dtype == b.dtype and np.array_equal(a, b)
        tolerance = np.zeros((4, 4))
        tolerance[:3, :3] = rotation_tolerance
        return bool(np.all(np.abs(a - b) <= tolerance))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(inner, a, b))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(inner(a[key], b[key]) for key in a)
    return bool(a == b)
