"""Why there is a loop here, or none: one row of words for each candidate, on screen and in a file.

A run leaves them as ``candidates.csv``; `covinz why` shows those of a keyframe.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from covinz import evaluation
from covinz.types import Array, JobRecord, JobState, KeyframeId, LoopClosure, Rejection

LOOP = "loop closure"


class CandidatesError(ValueError):
    """A file of candidates that cannot be read; the message names it."""


class Candidate(NamedTuple):
    """One candidate in words; what is not known is empty.

    Attributes:
        query: The keyframe whose arrival triggered the search.
        candidate: The keyframe it was compared with.
        score: Of place recognition.
        outcome: `LOOP`, the stage at which it was rejected, or what it waits for.
        counted: What was counted at that stage; of a loop its inliers.
        needed: What would have been enough.
        detail: More for a person.
        solver_ms: Time of the numeric core.
        error_m: Of a loop, against ground truth.
        error_deg: Likewise.
    """

    query: str
    candidate: str
    score: str
    outcome: str
    counted: str = ""
    needed: str = ""
    detail: str = ""
    solver_ms: str = ""
    error_m: str = ""
    error_deg: str = ""

    def concerns(self, keyframe: str) -> bool:
        """Whether AGENT, AGENT/SEQ or AGENT/SESSION/SEQ names one of its keyframes."""
        for name in (self.query, self.candidate):
            agent, _, rest = name.partition("/")
            if keyframe in (agent, f"{agent}/{rest.rpartition('/')[2]}", name):
                return True
        return False


def candidates(
    records: Iterable[JobRecord], true_poses: Mapping[KeyframeId, Array] | None = None
) -> list[Candidate]:
    """Put the dispatcher's records into words; loops with their errors where truth is known."""
    return [_candidate(record, true_poses or {}) for record in records]


def short_name(keyframe: str, rows: Iterable[Candidate]) -> str:
    """AGENT/SEQ, unless the rows name more than one session of the agent."""
    agent, session, seq = keyframe.split("/")
    names = (name.split("/") for row in rows for name in (row.query, row.candidate))
    sessions = {other[1] for other in names if other[0] == agent}
    return f"{agent}/{seq}" if sessions <= {session} else keyframe


def write_candidates(file: Path, rows: Sequence[Candidate]) -> None:
    """Write a CSV file with a line of headings."""
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(Candidate._fields)
        writer.writerows(rows)


def read_candidates(file: Path) -> list[Candidate]:
    """Read what `write_candidates` wrote.

    Raises:
        CandidatesError: If the file cannot be read or is something else.
    """
    try:
        with file.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise CandidatesError(f"cannot read {file}: {error}") from error
    if not rows or tuple(rows[0]) != Candidate._fields:
        raise CandidatesError(f"{file} is not a run's list of candidates")
    if any(len(row) != len(Candidate._fields) for row in rows):
        raise CandidatesError(f"{file} has lines that are cut off")
    return [Candidate(*row) for row in rows[1:]]


def _candidate(record: JobRecord, true_poses: Mapping[KeyframeId, Array]) -> Candidate:
    job = record.job
    head = (str(job.query), str(job.cand), f"{job.score:.1f}")
    match record.outcome:
        case LoopClosure() as loop:
            inliers, ms = f"{loop.num_inliers}", f"{loop.solver_ms:.1f}"
            return Candidate(*head, LOOP, inliers, "", "", ms, *_errors(loop, true_poses))
        case Rejection() as no:
            counted, needed = f"{no.count:g}", f"{no.threshold:g}"
            return Candidate(*head, no.stage, counted, needed, no.detail, f"{no.solver_ms:.1f}")
    waiting = "leased" if record.state is JobState.LEASED else "waiting for a worker"
    return Candidate(*head, waiting)


def _errors(loop: LoopClosure, true_poses: Mapping[KeyframeId, Array]) -> tuple[str, str]:
    cand, query = true_poses.get(loop.cand), true_poses.get(loop.query)
    if cand is None or query is None:
        return "", ""
    errors = evaluation.relative_errors(evaluation.true_loops(cand, query), loop.T_cand_query)
    turned_deg = float(np.rad2deg(errors.rotation_rad))
    return f"{float(errors.translation_m):.4f}", f"{turned_deg:.3f}"
