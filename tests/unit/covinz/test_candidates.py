"""Candidates in words, and the file of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from covinz import candidates, frames
from covinz.candidates import Candidate, CandidatesError
from covinz.types import (
    JobRecord,
    JobState,
    KeyframeId,
    LoopClosure,
    LoopJob,
    Outcome,
    Rejection,
    RigMember,
)

QUERY = KeyframeId("b", "0" * 25 + "B", 12)
CAND = KeyframeId("a", "0" * 25 + "A", 3)


def record(outcome: Outcome | None, state: JobState = JobState.DONE) -> JobRecord:
    rigs = [(RigMember(keyframe, np.eye(4), "0" * 16),) for keyframe in (QUERY, CAND)]
    return JobRecord(LoopJob("1" * 32, rigs[0], rigs[1], 31.25), state, 1, outcome)


LOOP = LoopClosure(
    "1" * 32, QUERY, CAND, frames.transform(np.eye(3), [1.0, 0.0, 0.0]), np.eye(6), 140, 300, 61.0
)
NO = Rejection("1" * 32, QUERY, CAND, "pair_inliers", 12, 30, 'pair 2, "left", 7 px', 5.5)


def test_a_loop_says_its_inliers_and_its_error_where_truth_is_known() -> None:
    truth = {QUERY: frames.transform(np.eye(3), [1.25, 0.0, 0.0]), CAND: np.eye(4)}
    (known,) = candidates.candidates([record(LOOP)], truth)
    head = (str(QUERY), str(CAND), "31.2", candidates.LOOP, "140", "", "", "61.0")
    assert known == (*head, "0.2500", "0.000")
    (blind,) = candidates.candidates([record(LOOP)])
    assert blind == (*head, "", "")


def test_a_rejection_says_at_which_stage_and_what_would_have_been_enough() -> None:
    (row,) = candidates.candidates([record(NO)])
    assert row[3:8] == ("pair_inliers", "12", "30", 'pair 2, "left", 7 px', "5.5")


@pytest.mark.parametrize(
    ("state", "words"),
    [(JobState.LEASED, "leased"), (JobState.PENDING, "waiting for a worker")],
)
def test_a_job_without_outcome_says_what_it_waits_for(state: JobState, words: str) -> None:
    (row,) = candidates.candidates([record(None, state)])
    assert row.outcome == words


def test_the_file_gives_back_what_was_written(tmp_path: Path) -> None:
    rows = candidates.candidates([record(LOOP), record(NO), record(None, JobState.LEASED)])
    file = tmp_path / "candidates.csv"
    candidates.write_candidates(file, rows)
    assert candidates.read_candidates(file) == rows


@pytest.mark.parametrize("content", [b"", b"query,cand\n", b"\xff\xfe\x00", b"a" * 10])
def test_another_file_is_refused_by_name(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "candidates.csv"
    file.write_bytes(content)
    with pytest.raises(CandidatesError, match=r"candidates\.csv"):
        candidates.read_candidates(file)


def test_a_file_that_is_cut_off_or_missing_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "candidates.csv"
    candidates.write_candidates(file, candidates.candidates([record(NO)]))
    file.write_text(file.read_text()[:-40])
    with pytest.raises(CandidatesError, match="cut off"):
        candidates.read_candidates(file)
    with pytest.raises(CandidatesError, match="cannot read"):
        candidates.read_candidates(tmp_path / "gone.csv")


@pytest.mark.parametrize("name", ["a", "b", "a/3", "b/12", str(QUERY), str(CAND)])
def test_a_candidate_concerns_both_its_keyframes(name: str) -> None:
    (row,) = candidates.candidates([record(NO)])
    assert row.concerns(name)


@pytest.mark.parametrize("name", ["c", "a/12", "b/3", "a/", "", str(CAND)[:-1] + "4"])
def test_a_candidate_concerns_nobody_else(name: str) -> None:
    (row,) = candidates.candidates([record(NO)])
    assert not row.concerns(name)


def test_names_are_short_while_an_agent_has_one_session() -> None:
    row = Candidate("a/S1/4", "b/S2/7", "1", "matches")
    other = Candidate("a/S3/4", "b/S2/9", "1", "matches")
    assert candidates.short_name("a/S1/4", [row]) == "a/4"
    assert candidates.short_name("a/S1/4", [row, other]) == "a/S1/4"
    assert candidates.short_name("b/S2/7", [row, other]) == "b/7"
