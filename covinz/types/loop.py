"""Loop jobs and what becomes of them."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from covinz.types.identity import Array, KeyframeId, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class RigMember:
    """One camera of a rig.

    Attributes:
        keyframe: Its keyframe.
        T_odom_body: (4, 4) odometry pose of the keyframe.
        camera_hash: Its calibration.
        motion_covariance: (6, 6) of odometry's motion to this keyframe from the rig's previous one
            in order of time: right perturbation [rotation (rad), translation (m)], in this body
            frame. None for the earliest, and where nobody said.
        twists: (2, 6) how the body moved before and after the image's stamp, [rotation (rad/s),
            translation (m/s)] in the body frame. None where nobody said.
    """

    keyframe: KeyframeId
    T_odom_body: Array
    camera_hash: str
    motion_covariance: Array | None = None
    twists: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_odom_body", frozen_array(self.T_odom_body, (4, 4)))
        if self.motion_covariance is not None:
            covariance = frozen_array(self.motion_covariance, (6, 6))
            object.__setattr__(self, "motion_covariance", covariance)
        if self.twists is not None:
            object.__setattr__(self, "twists", frozen_array(self.twists, (2, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class LoopJob:
    """A candidate pair to verify; self-contained and fixed when it is created.

    Attributes:
        id: 32 hex digits: hash of query, candidate, configuration (solver, rigs) and vocabulary.
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
class MotionResidual:
    """What the adjustment of a rig found against odometry, for one motion inside it.

    Attributes:
        from_keyframe: Where the motion begins.
        to_keyframe: Where it ends; of the same session.
        residual: (6,) [rotation, translation], in odometry's standard deviations as the solver
            took them.
    """

    from_keyframe: KeyframeId
    to_keyframe: KeyframeId
    residual: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "residual", frozen_array(self.residual, (6,)))


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
        num_inliers: Matches of all pairs together that the pose explains.
        num_matches: Descriptor matches of all pairs together.
        solver_ms: Time of the numeric core for this job.
        motion_residuals: One for each motion inside the two rigs; empty where rigs are rigid.
        log_id: The log that the job is of; empty when nobody said.
    """

    job_id: str
    query: KeyframeId
    cand: KeyframeId
    T_cand_query: Array
    covariance: Array
    num_inliers: int
    num_matches: int
    solver_ms: float
    motion_residuals: tuple[MotionResidual, ...] = ()
    log_id: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_cand_query", frozen_array(self.T_cand_query, (4, 4)))
        object.__setattr__(self, "covariance", frozen_array(self.covariance, (6, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class LoopSolution:
    """One of several poses that explain the matches alike.

    Attributes:
        T_cand_query: (4, 4) as in LoopClosure.
        covariance: (6, 6) as in LoopClosure, were this the right one.
        num_inliers: Matches that it explains.
        cost: -2 log likelihood; only differences within one rejection mean something.
    """

    T_cand_query: Array
    covariance: Array
    num_inliers: int
    cost: float

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
        solutions: Of the stage ``ambiguous``: the best solution and the one nearly as good.
    """

    job_id: str
    query: KeyframeId
    cand: KeyframeId
    stage: str
    count: float
    threshold: float
    detail: str
    solver_ms: float
    solutions: tuple[LoopSolution, ...] = ()


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
        log_id: The log that the job is of; empty when nobody said.
    """

    job: LoopJob
    worker: str
    attempt: int
    duration_s: float
    log_id: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class JobDone:
    """A worker returns the outcome of a job; accepted whatever became of its lease.

    Attributes:
        worker: Who solved it.
        outcome: What came of it.
        log_id: The log that the job is of, as its lease said; empty when nobody said.
        wants_next: Whether the worker asks for its next job with this. If there is one at once, its
            Lease is the answer in place of Stored or Duplicate.
    """

    worker: str
    outcome: Outcome
    log_id: str = ""
    wants_next: bool = False


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


@dataclass(frozen=True, slots=True)
class LoopRange:
    """Asks the dispatcher for accepted loops with a job id greater than `after` ("": all)."""

    after: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class LoopPage:
    """Accepted loops of one log in order of their job ids; empty when there are no more."""

    log_id: str
    loops: tuple[LoopClosure, ...]
