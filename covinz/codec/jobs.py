"""Loops on their way: LoopJob, LoopClosure, Rejection, Lease, JobDone, JobPage and questions."""

from __future__ import annotations

from typing import Final

from covinz.codec import poses, rigs, values
from covinz.codec.reader import Fields
from covinz.types import (
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
)

_WIRE_STATE: Final = {state: state.name.capitalize() for state in JobState}
_STATE_OF_WIRE: Final = {name: state for state, name in _WIRE_STATE.items()}


def loop_job_fields(job: LoopJob) -> Fields:
    """Fields of a LoopJob."""
    query_rig, cand_rig = rigs.rig_fields(job.query_rig, job.cand_rig)
    return {
        "id": values.text(job.id, "id", values.JOB_ID),
        "query_rig": query_rig,
        "cand_rig": cand_rig,
        "score": values.finite(job.score, "score"),
    }


def loop_job(fields: Fields) -> LoopJob:
    """The inverse of `loop_job_fields`."""
    query_rig, cand_rig = rigs.rigs_of(fields["query_rig"], fields["cand_rig"])
    return LoopJob(
        id=values.text(fields["id"], "id", values.JOB_ID),
        query_rig=query_rig,
        cand_rig=cand_rig,
        score=values.finite(fields["score"], "score"),
    )


def loop_closure_fields(loop: LoopClosure) -> Fields:
    """Fields of a LoopClosure."""
    return {
        "job_id": values.text(loop.job_id, "job_id", values.JOB_ID),
        "query": values.keyframe_id_fields(loop.query),
        "cand": values.keyframe_id_fields(loop.cand),
        "pose_cand_query": tuple(poses.pose_values(loop.T_cand_query, "T_cand_query")),
        "covariance": values.covariance(loop.covariance, "covariance", definite=True),
        "num_inliers": values.whole(loop.num_inliers, "num_inliers", 0, values.MAX_COUNT),
        "num_matches": values.whole(loop.num_matches, "num_matches", 0, values.MAX_COUNT),
        "solver_ms": values.finite(loop.solver_ms, "solver_ms", low=0.0),
        "motion_residuals": [_motion_fields(motion) for motion in loop.motion_residuals] or None,
        "log_id": values.maybe_log_id(loop.log_id),
    }


def loop_closure(fields: Fields) -> LoopClosure:
    """The inverse of `loop_closure_fields`."""
    covariance = values.covariance(fields["covariance"], "covariance", definite=True)
    return LoopClosure(
        job_id=values.text(fields["job_id"], "job_id", values.JOB_ID),
        query=values.keyframe_id(fields["query"]),
        cand=values.keyframe_id(fields["cand"]),
        T_cand_query=poses.transforms(fields["pose_cand_query"], "T_cand_query"),
        covariance=covariance.reshape(6, 6),
        num_inliers=fields["num_inliers"],
        num_matches=fields["num_matches"],
        solver_ms=values.finite(fields["solver_ms"], "solver_ms", low=0.0),
        motion_residuals=tuple(_motion(motion) for motion in fields["motion_residuals"] or ()),
        log_id=values.maybe_log_id(fields["log_id"]) or "",
    )


def _motion_fields(motion: MotionResidual) -> Fields:
    return {
        "from": values.keyframe_id_fields(motion.from_keyframe),
        "to": values.keyframe_id_fields(motion.to_keyframe),
        "residual": values.numbers(motion.residual, "residual", 6),
    }


def _motion(fields: Fields) -> MotionResidual:
    return MotionResidual(
        values.keyframe_id(fields["from"]),
        values.keyframe_id(fields["to"]),
        values.numbers(fields["residual"], "residual", 6),
    )


def rejection_fields(rejection: Rejection) -> Fields:
    """Fields of a Rejection."""
    return {
        "job_id": values.text(rejection.job_id, "job_id", values.JOB_ID),
        "query": values.keyframe_id_fields(rejection.query),
        "cand": values.keyframe_id_fields(rejection.cand),
        "stage": values.text(rejection.stage, "stage", values.CODE),
        "count": values.finite(rejection.count, "count"),
        "threshold": values.finite(rejection.threshold, "threshold"),
        "detail": values.text(rejection.detail, "detail") or None,
        "solver_ms": values.finite(rejection.solver_ms, "solver_ms", low=0.0),
        "solutions": [_solution_fields(solution) for solution in rejection.solutions] or None,
    }


def rejection(fields: Fields) -> Rejection:
    """The inverse of `rejection_fields`."""
    return Rejection(
        job_id=values.text(fields["job_id"], "job_id", values.JOB_ID),
        query=values.keyframe_id(fields["query"]),
        cand=values.keyframe_id(fields["cand"]),
        stage=values.text(fields["stage"], "stage", values.CODE),
        count=values.finite(fields["count"], "count"),
        threshold=values.finite(fields["threshold"], "threshold"),
        detail=fields["detail"] or "",
        solver_ms=values.finite(fields["solver_ms"], "solver_ms", low=0.0),
        solutions=tuple(_solution(solution) for solution in fields["solutions"] or ()),
    )


def _solution_fields(solution: LoopSolution) -> Fields:
    return {
        "pose_cand_query": tuple(poses.pose_values(solution.T_cand_query, "T_cand_query")),
        "covariance": values.covariance(solution.covariance, "covariance", definite=True),
        "num_inliers": values.whole(solution.num_inliers, "num_inliers", 0, values.MAX_COUNT),
        "cost": values.finite(solution.cost, "cost"),
    }


def _solution(fields: Fields) -> LoopSolution:
    covariance = values.covariance(fields["covariance"], "covariance", definite=True)
    return LoopSolution(
        T_cand_query=poses.transforms(fields["pose_cand_query"], "T_cand_query"),
        covariance=covariance.reshape(6, 6),
        num_inliers=fields["num_inliers"],
        cost=values.finite(fields["cost"], "cost"),
    )


def _outcome_fields(outcome: Outcome) -> tuple[str, Fields]:
    if isinstance(outcome, LoopClosure):
        return "LoopClosure", loop_closure_fields(outcome)
    return "Rejection", rejection_fields(outcome)


def _outcome(value: tuple[str, Fields]) -> Outcome:
    name, fields = value
    return loop_closure(fields) if name == "LoopClosure" else rejection(fields)


def lease_request_fields(request: LeaseRequest) -> Fields:
    """Fields of a LeaseRequest."""
    return {"worker": values.text(request.worker, "worker", values.INSTANCE)}


def lease_request(fields: Fields) -> LeaseRequest:
    """The inverse of `lease_request_fields`."""
    return LeaseRequest(values.text(fields["worker"], "worker", values.INSTANCE))


def lease_fields(lease: Lease) -> Fields:
    """Fields of a Lease."""
    return {
        "job": loop_job_fields(lease.job),
        "worker": values.text(lease.worker, "worker", values.INSTANCE),
        "attempt": values.whole(lease.attempt, "attempt", 1, values.MAX_COUNT),
        "duration_s": values.finite(lease.duration_s, "duration_s", low=0.0),
        "log_id": values.maybe_log_id(lease.log_id),
    }


def lease(fields: Fields) -> Lease:
    """The inverse of `lease_fields`."""
    return Lease(
        job=loop_job(fields["job"]),
        worker=values.text(fields["worker"], "worker", values.INSTANCE),
        attempt=values.whole(fields["attempt"], "attempt", 1, values.MAX_COUNT),
        duration_s=values.finite(fields["duration_s"], "duration_s", low=0.0),
        log_id=values.maybe_log_id(fields["log_id"]) or "",
    )


def job_done_fields(done: JobDone) -> Fields:
    """Fields of a JobDone."""
    worker = values.text(done.worker, "worker", values.INSTANCE)
    return {
        "worker": worker,
        "outcome": _outcome_fields(done.outcome),
        "log_id": values.maybe_log_id(done.log_id),
        "wants_next": bool(done.wants_next),
    }


def job_done(fields: Fields) -> JobDone:
    """The inverse of `job_done_fields`."""
    worker = values.text(fields["worker"], "worker", values.INSTANCE)
    log_id = values.maybe_log_id(fields["log_id"]) or ""
    return JobDone(worker, _outcome(fields["outcome"]), log_id, fields["wants_next"])


def job_range_fields(wanted: JobRange) -> Fields:
    """Fields of a JobRange."""
    return {"first": values.whole(wanted.first, "first")}


def job_range(fields: Fields) -> JobRange:
    """The inverse of `job_range_fields`."""
    return JobRange(values.whole(fields["first"], "first"))


def _record_fields(record: JobRecord) -> Fields:
    return {
        "job": loop_job_fields(record.job),
        "state": _WIRE_STATE[record.state],
        "attempts": values.whole(record.attempts, "attempts", 0, values.MAX_COUNT),
        "outcome": None if record.outcome is None else _outcome_fields(record.outcome),
    }


def _record(fields: Fields) -> JobRecord:
    if fields["state"] is None:
        raise ValueError("records.state is missing")
    return JobRecord(
        job=loop_job(fields["job"]),
        state=_STATE_OF_WIRE[fields["state"]],
        attempts=fields["attempts"],
        outcome=None if fields["outcome"] is None else _outcome(fields["outcome"]),
    )


def job_page_fields(page: JobPage) -> Fields:
    """Fields of a JobPage."""
    return {
        "total": values.whole(page.total, "total"),
        "first": values.whole(page.first, "first"),
        "records": [_record_fields(record) for record in page.records],
    }


def job_page(fields: Fields) -> JobPage:
    """The inverse of `job_page_fields`."""
    records = tuple(_record(record) for record in fields["records"])
    return JobPage(
        values.whole(fields["total"], "total"), values.whole(fields["first"], "first"), records
    )


def loop_range_fields(wanted: LoopRange) -> Fields:
    """Fields of a LoopRange."""
    return {"after": values.text(wanted.after, "after", values.JOB_ID) if wanted.after else None}


def loop_range(fields: Fields) -> LoopRange:
    """The inverse of `loop_range_fields`."""
    after = fields["after"]
    return LoopRange(values.text(after, "after", values.JOB_ID) if after else "")


def loop_page_fields(page: LoopPage) -> Fields:
    """Fields of a LoopPage."""
    return {
        "log_id": values.maybe_log_id(page.log_id),
        "loops": [loop_closure_fields(loop) for loop in page.loops],
    }


def loop_page(fields: Fields) -> LoopPage:
    """The inverse of `loop_page_fields`."""
    loops = tuple(loop_closure(loop) for loop in fields["loops"])
    return LoopPage(values.maybe_log_id(fields["log_id"]) or "", loops)
