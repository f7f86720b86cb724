from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest

from covinz import codec
from covinz.damage import CommitFailed, Trouble
from covinz.durable import DurableFileError
from covinz.types import JobState, KeyframeId, LoopClosure, Rejection
from services.place_recognition.journal import Journal

LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
OTHER_LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAW"
QUERY = KeyframeId("a", LOG, 7)
CAND = KeyframeId("b", OTHER_LOG, 3)


def job_id(n: int) -> str:
    return f"{n:032x}"


def loop(n: int) -> LoopClosure:
    covariance = 1e-4 * np.eye(6)
    return LoopClosure(job_id(n), QUERY, CAND, np.eye(4), covariance, 120, 400, 83.5)


def rejection(n: int, stage: str = "pair_inliers") -> Rejection:
    return Rejection(job_id(n), QUERY, CAND, stage, 12.0, 30.0, "", 4.0)


Reopen = Callable[[], Journal]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "place_recognition.sqlite"


@pytest.fixture
def reopen(path: Path) -> Iterator[Reopen]:
    """Opens the journal; again as after a crash: what was not committed is gone."""
    with ExitStack() as stack:

        def reopen() -> Journal:
            stack.close()
            return stack.enter_context(closing(Journal(path)))

        yield reopen


@pytest.fixture
def journal(reopen: Reopen) -> Journal:
    journal = reopen()
    journal.adopt(LOG)
    return journal


def test_what_was_committed_survives(journal: Journal, reopen: Reopen) -> None:
    journal.note_failures(job_id(1), 1)
    journal.note_failures(job_id(1), 2)
    journal.note_failures(job_id(2), 1)
    journal.note_outcome(loop(2), JobState.DONE)
    journal.note_outcome(rejection(3, "dead_letter"), JobState.DEAD)
    journal.commit()
    again = reopen()
    assert again.log_id == LOG
    assert (again.recall(job_id(1)).failures, again.recall(job_id(1)).state) == (
        2,
        JobState.PENDING,
    )
    known = again.recall(job_id(2))
    assert (known.failures, known.state) == (1, JobState.DONE)
    assert known.outcome is not None
    assert codec.encode(known.outcome) == codec.encode(loop(2))
    assert again.recall(job_id(3)).state is JobState.DEAD
    assert again.recall(job_id(3)).outcome == rejection(3, "dead_letter")


def test_what_was_not_committed_is_lost(journal: Journal, reopen: Reopen) -> None:
    journal.note_outcome(loop(1), JobState.DONE)
    journal.commit()
    journal.note_outcome(loop(2), JobState.DONE)
    again = reopen()
    assert again.recall(job_id(1)).state is JobState.DONE
    assert again.recall(job_id(2)).state is JobState.PENDING


def test_an_unknown_job_has_no_past(journal: Journal) -> None:
    known = journal.recall(job_id(9))
    assert (known.failures, known.state, known.outcome) == (0, JobState.PENDING, None)


def test_the_same_log_keeps_and_another_forgets(journal: Journal, reopen: Reopen) -> None:
    journal.note_outcome(loop(1), JobState.DONE)
    journal.commit()
    again = reopen()
    again.adopt(LOG)
    assert again.recall(job_id(1)).state is JobState.DONE
    again.adopt(OTHER_LOG)
    again.commit()
    assert again.recall(job_id(1)).state is JobState.PENDING
    last = reopen()
    assert last.log_id == OTHER_LOG
    assert last.recall(job_id(1)).state is JobState.PENDING


def test_a_dead_job_may_still_be_done(journal: Journal) -> None:
    journal.note_failures(job_id(1), 3)
    journal.note_outcome(rejection(1, "dead_letter"), JobState.DEAD)
    journal.note_outcome(loop(1), JobState.DONE)
    known = journal.recall(job_id(1))
    assert (known.failures, known.state) == (3, JobState.DONE)
    assert isinstance(known.outcome, LoopClosure)


def test_one_owner_at_a_time(journal: Journal, path: Path) -> None:
    with pytest.raises(DurableFileError, match="in use"):
        Journal(path)


def test_what_could_not_be_written_counts_and_is_written_later(
    journal: Journal, reopen: Reopen
) -> None:
    journal.note_failures(job_id(1), 1)
    journal.commit()
    db = journal._file.db
    (pages,) = db.execute("PRAGMA page_count").fetchone()
    db.execute(f"PRAGMA max_page_count = {pages}")
    for n in range(200):
        journal.note_outcome(loop(n), JobState.DONE)
    for _ in range(3):
        with pytest.raises(CommitFailed) as caught:
            journal.commit()
        assert caught.value.trouble is Trouble.DISK_FULL
        assert journal.recall(job_id(1)).state is JobState.DONE
        assert journal.recall(job_id(1)).failures == 1
    db.execute("PRAGMA max_page_count = 1000000")
    journal.commit()
    journal = reopen()
    assert all(journal.recall(job_id(n)).state is JobState.DONE for n in range(200))
    assert journal.recall(job_id(1)).failures == 1


def test_a_job_whose_outcome_is_damaged_is_done_again(journal: Journal, reopen: Reopen) -> None:
    journal.note_outcome(loop(1), JobState.DONE)
    journal.note_outcome(loop(2), JobState.DONE)
    journal.commit()
    journal._file.db.execute("UPDATE job SET outcome = x'00' WHERE id = ?", (job_id(1),))
    journal = reopen()
    assert journal.recall(job_id(1)).state is JobState.PENDING
    assert journal.recall(job_id(2)).state is JobState.DONE
