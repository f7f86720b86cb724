from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from covinz.config import WorkerConfig
from covinz.types import (
    JobState,
    KeyframeId,
    LoopClosure,
    LoopJob,
    Rejected,
    RetryAfter,
    RigMember,
)
from services.place_recognition import dispatcher as module
from services.place_recognition.dispatcher import Dispatcher
from services.place_recognition.journal import Journal
from tests.dispatching import CONFIG, LOG, job, loop, make, member, rejection

OTHER_LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAW"


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    journal = Journal(tmp_path / "place_recognition.sqlite")
    yield journal
    journal.close()


@pytest.fixture
def desk(journal: Journal) -> Dispatcher[str]:
    return make(journal)


def lent(desk: Dispatcher[str], now_s: float) -> list[tuple[str, str, int]]:
    """Who got which job for the how manieth time."""
    return [
        (asker, lease.job.id[-2:], lease.attempt) for asker, lease in desk.advance(now_s).granted
    ]


def test_jobs_and_workers_are_served_in_order(desk: Dispatcher[str]) -> None:
    desk.request("w1", "r1", 0.0)
    desk.request("w2", "r2", 0.0)
    assert lent(desk, 0.0) == []
    for n in range(3):
        desk.add(job(n))
    # The newest first, for all of them might join two maps.
    assert lent(desk, 0.1) == [("r1", "02", 1), ("r2", "01", 1)]
    assert (desk.pending, desk.leased) == (1, 2)
    desk.request("w3", "r3", 0.2)
    assert lent(desk, 0.2) == [("r3", "00", 1)]


def test_a_worker_gets_jobs_of_keyframes_that_it_has(desk: Dispatcher[str]) -> None:
    for n in (20, 0, 1, 21):
        desk.add(job(n))
    for worker in ("w1", "w2", "w1", "w2"):
        desk.request(worker, worker, 0.0)
        ((_, lease),) = desk.advance(0.0).granted
        desk.finish(rejection(int(lease.job.id, 16)), worker)
        if worker == "w1":
            assert int(lease.job.id, 16) in (20, 21)


def test_a_lease_says_how_long_it_lasts(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    desk.request("w", "r", 0.0)
    ((_, lease),) = desk.advance(0.0).granted
    assert (lease.worker, lease.duration_s) == ("w", CONFIG.lease_s)


def test_an_outcome_ends_the_job(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    desk.request("w", "r", 0.0)
    desk.advance(0.0)
    assert desk.finish(loop(0))
    assert (desk.pending, desk.leased) == (0, 0)
    assert desk.counters == {"accepted": 1, "returned": 0}
    assert not desk.finish(rejection(0))
    (record,) = desk.page(0).records
    assert record.state is JobState.DONE and isinstance(record.outcome, LoopClosure)


def test_outcomes_before_the_log_is_known(desk: Dispatcher[str], journal: Journal) -> None:
    journal.commit()
    # A restart: the journal's log is the likely one, but not certain.
    again: Dispatcher[str] = Dispatcher(CONFIG, WorkerConfig(), journal)
    assert again.objection(LOG) is None
    assert again.objection("") is None
    assert isinstance(again.objection(OTHER_LOG), RetryAfter)
    again.reset(OTHER_LOG)
    assert again.objection(OTHER_LOG) is None
    assert isinstance(again.objection(LOG), Rejected)


def test_a_lease_ends_at_its_deadline(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    desk.request("w1", "r1", 0.0)
    assert lent(desk, 0.0) == [("r1", "00", 1)]
    assert desk.next_deadline_s() == 60.0
    assert lent(desk, 59.9) == []
    desk.request("w2", "r2", 60.0)
    assert lent(desk, 60.0) == [("r2", "00", 2)]
    assert desk.counters["returned"] == 1


def test_a_lease_ends_when_its_worker_vanishes(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    desk.add(job(1))
    desk.request("w1", "r1", 0.0)
    assert lent(desk, 0.0) == [("r1", "01", 1)]
    desk.request("w2", "r2", 1.0)
    desk.worker_gone("w1")
    assert lent(desk, 1.0) == [("r2", "01", 2)]


def test_a_worker_that_only_lost_its_link_keeps_its_job(journal: Journal) -> None:
    desk = make(journal, 1)
    desk.request("w", "r", 0.0)
    desk.advance(0.0)
    for _ in range(5):  # restarts of the router
        desk.worker_gone("w")
        assert (desk.pending, desk.leased) == (1, 0)
        assert journal.recall(job(0).id).failures == 1
        desk.worker_back("w")
        assert (desk.pending, desk.leased) == (0, 1)
        assert journal.recall(job(0).id).failures == 0
    assert desk.next_deadline_s() == 60.0
    assert desk.advance(60.0).dead == ()
    assert desk.page(0).records[0].attempts == 1


def test_a_job_that_went_to_another_meanwhile_has_not_failed(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    desk.request("w1", "r1", 0.0)
    desk.advance(0.0)
    desk.worker_gone("w1")
    desk.request("w2", "r2", 0.0)
    assert lent(desk, 0.0) == [("r2", "00", 2)]
    desk.worker_back("w1")
    assert desk.page(0).records[0].attempts == 1
    # Two at work on one job: the first outcome counts.
    assert desk.finish(loop(0), "w1") and not desk.finish(rejection(0), "w2")
    assert (desk.pending, desk.leased) == (0, 0)


def lose_three_workers(desk: Dispatcher[str]) -> None:
    """A new job is dead after them."""
    desk.add(job(0))
    for worker in ("w1", "w2", "w3"):
        desk.request(worker, worker, 0.0)
        desk.advance(0.0)
        desk.worker_gone(worker)
    assert len(desk.advance(0.0).dead) == 1


def test_a_job_given_up_too_early_is_taken_up_again(desk: Dispatcher[str]) -> None:
    lose_three_workers(desk)
    desk.worker_back("w3")
    record = desk.page(0).records[0]
    assert (record.state, record.attempts, record.outcome) == (JobState.LEASED, 3, None)
    assert desk.counters["rejected.dead_letter"] == 0


def test_a_dead_job_waits_again_when_one_of_its_workers_only_lost_its_link(
    desk: Dispatcher[str], journal: Journal
) -> None:
    lose_three_workers(desk)
    # It has not the job any more: it asks for one.
    desk.request("w1", "late", 1.0)
    desk.request("w1", "again", 1.0)
    assert desk.counters["rejected.dead_letter"] == 0
    assert journal.recall(job(0).id).outcome is None
    assert lent(desk, 1.0) == [("again", "00", 3)]
    desk.worker_gone("w1")
    assert len(desk.advance(1.0).dead) == 1
    record = desk.page(0).records[0]
    assert (record.state, record.attempts) == (JobState.DEAD, 3)


def test_a_dead_job_may_be_tried_again(journal: Journal) -> None:
    desk = make(journal, 2)
    for worker in ("w1", "w2", "w3"):
        desk.request(worker, worker, 0.0)
        assert lent(desk, 0.0)[0][1] == "01"
        desk.worker_gone(worker)
    desk.advance(0.0)
    assert not desk.retry(job(0).id) and not desk.retry("unknown")
    assert desk.retry(job(1).id)
    assert (desk.pending, desk.counters["rejected.dead_letter"]) == (2, 0)
    journal.commit()
    assert journal.recall(job(1).id).outcome is None
    desk.request("w4", "r4", 1.0)
    assert lent(desk, 1.0) == [("r4", "01", 1)]


def test_too_many_jobs_are_shed_and_say_so(journal: Journal) -> None:
    config = CONFIG.model_copy(update={"max_pending_jobs": 10})
    desk: Dispatcher[str] = Dispatcher(config, WorkerConfig(), journal)
    desk.reset(LOG)
    for n in range(10):
        desk.add(job(n))
        desk.shed()
    assert desk.is_full and desk.advance(0.0).shed == ()
    desk.add(job(10))
    desk.shed()
    # The oldest go, for all of them might join two maps.
    shed = desk.advance(0.0).shed
    assert [one.job_id for one in shed] == [job(1).id, job(0).id]
    assert {(one.stage, one.count, one.threshold) for one in shed} == {("shed", 11, 10)}
    assert (desk.pending, desk.counters["rejected.shed"]) == (9, 2)
    # For good, also after a restart, unless somebody asks for them.
    journal.commit()
    again = make(journal, 11)
    assert (again.pending, again.counters["rejected.shed"]) == (9, 2)
    assert again.retry(job(0).id)
    assert again.pending == 10


def test_who_waits_follows_the_accepted_loops(desk: Dispatcher[str]) -> None:
    for n in (0, 50, 20):
        desk.add(job(n))
    assert desk.finish(loop(0))  # now a and b share a map
    other = RigMember(KeyframeId("c", LOG, 0), np.eye(4), "0123456789abcdef")
    desk.add(LoopJob(f"{99:032x}", (other,), (member("a", 3),), 1.0))
    for number in range(3):
        desk.request(f"w{number}", f"r{number}", 0.0)
    # Between maps, then the longest way over the known loop.
    assert [name for _, name, _ in lent(desk, 0.0)] == [f"{99:02x}", f"{50:02x}", f"{20:02x}"]


def test_a_vanished_worker_s_request_is_not_served(desk: Dispatcher[str]) -> None:
    desk.request("w1", "r1", 0.0)
    desk.worker_gone("w1")
    desk.add(job(0))
    effects = desk.advance(0.0)
    assert effects.turned_away == ("r1",) and effects.granted == ()


def test_a_request_overtaken_by_its_worker_s_end_is_not_served(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    desk.worker_gone("w1")
    desk.request("w1", "r1", 0.0)
    assert desk.advance(0.0).turned_away == ("r1",)
    # A worker whose token only flickered asks again and is served.
    desk.request("w1", "r2", 0.1)
    assert lent(desk, 0.1) == [("r2", "00", 1)]


def test_asking_again_gives_the_lease_back(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    desk.request("w", "lost on the way", 0.0)
    desk.advance(0.0)
    desk.request("w", "r2", 8.0)
    assert lent(desk, 8.0) == [("r2", "00", 1)]


def test_leases_that_never_arrive_do_not_use_a_job_up(journal: Journal) -> None:
    desk = make(journal, num_jobs=1)
    for n in range(9):
        desk.request("w", f"r{n}", float(n))
        assert lent(desk, float(n)) == [(f"r{n}", "00", 1)]
    # Nor after a restart, which tells nothing of the worker that had it.
    journal.commit()
    again = make(journal, num_jobs=1)
    again.request("w", "r", 20.0)
    assert lent(again, 20.0) == [("r", "00", 1)]


def test_a_second_request_replaces_the_first(desk: Dispatcher[str]) -> None:
    desk.request("w", "r1", 0.0)
    desk.request("w", "r2", 1.0)
    desk.add(job(0))
    effects = desk.advance(1.0)
    assert effects.turned_away == ("r1",)
    assert [asker for asker, _ in effects.granted] == ["r2"]


def test_a_request_is_held_for_a_while_only(desk: Dispatcher[str]) -> None:
    desk.request("w", "r", 0.0)
    assert desk.next_deadline_s() == 5.0
    assert desk.advance(4.9).turned_away == ()
    assert desk.advance(5.0).turned_away == ("r",)
    assert desk.next_deadline_s() is None


def test_a_job_that_kills_its_workers_is_given_up(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    for attempt in range(1, 4):
        desk.request(f"w{attempt}", f"r{attempt}", 0.0)
        assert lent(desk, 0.0) == [(f"r{attempt}", "00", attempt)]
        desk.worker_gone(f"w{attempt}")
    ((lost, dead),) = desk.advance(0.0).dead
    assert lost.id == job(0).id
    assert (dead.stage, dead.count, dead.threshold) == ("dead_letter", 3, 3)
    (record,) = desk.page(0).records
    assert (record.state, record.attempts, record.outcome) == (JobState.DEAD, 3, dead)
    assert (desk.pending, desk.leased) == (0, 0)
    assert desk.counters["rejected.dead_letter"] == 1
    assert desk.advance(1.0).dead == ()


def test_an_outcome_is_welcome_after_the_end_of_its_lease(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    desk.request("slow", "r1", 0.0)
    desk.advance(0.0)
    desk.request("w2", "r2", 61.0)
    assert lent(desk, 61.0) == [("r2", "00", 2)]
    assert desk.finish(loop(0))
    assert (desk.pending, desk.leased) == (0, 0)
    # The second worker's lease is over too: it may ask for the next job.
    desk.add(job(1))
    desk.request("w2", "r3", 62.0)
    assert lent(desk, 62.0) == [("r3", "01", 1)]
    assert desk.counters["returned"] == 1


def test_an_outcome_brings_a_dead_job_back(desk: Dispatcher[str]) -> None:
    desk.add(job(0))
    for worker in ("w1", "w2", "w3"):
        desk.request(worker, worker, 0.0)
        desk.advance(0.0)
        desk.worker_gone(worker)
    assert desk.finish(loop(0))
    assert desk.counters["accepted"] == 1
    assert desk.counters["rejected.dead_letter"] == 0
    assert desk.page(0).records[0].state is JobState.DONE


def test_an_outcome_of_a_pending_job_ends_it(desk: Dispatcher[str]) -> None:
    for n in range(3):
        desk.add(job(n))
    assert desk.finish(rejection(1))
    for worker in ("w1", "w2", "w3"):
        desk.request(worker, worker, 0.0)
    assert lent(desk, 0.0) == [("w1", "02", 1), ("w2", "00", 1)]


def test_pages_are_bounded(desk: Dispatcher[str]) -> None:
    count = module.PAGE_RECORDS + 3
    for n in range(count):
        desk.add(job(n))
    first, last = desk.page(0), desk.page(module.PAGE_RECORDS)
    assert (first.total, len(first.records)) == (count, module.PAGE_RECORDS)
    assert [r.job.id for r in last.records] == [job(n).id for n in range(count - 3, count)]
    assert desk.page(count + 5).records == ()


def test_a_restart_makes_leased_jobs_pending_and_skips_done_ones(journal: Journal) -> None:
    before = make(journal, 3)
    for worker in ("w1", "w2"):
        before.request(worker, worker, 0.0)
    before.advance(0.0)
    before.finish(loop(1))
    after = make(journal, 3)
    assert [r.state for r in after.page(0).records] == [
        JobState.PENDING,
        JobState.DONE,
        JobState.PENDING,
    ]
    assert after.counters["accepted"] == 1
    after.request("w3", "r3", 0.0)
    assert lent(after, 0.0) == [("r3", "02", 1)]


def test_an_outcome_may_come_before_its_job_is_made_again(journal: Journal) -> None:
    early = make(journal)
    assert early.finish(loop(0))
    assert not early.finish(loop(0))
    early.add(job(0))
    assert (early.pending, early.counters["accepted"]) == (0, 1)


def test_another_log_starts_over(journal: Journal) -> None:
    desk = make(journal, 2)
    desk.request("w", "r", 0.0)
    desk.advance(0.0)
    desk.finish(loop(1))
    desk.request("w2", "r2", 1.0)
    desk.advance(1.0)
    desk.request("w3", "open", 1.0)
    desk.reset(OTHER_LOG)
    assert (desk.pending, desk.leased, desk.page(0).total) == (0, 0, 0)
    desk.add(job(0))
    # The request that was open is served from the new log, and the old outcome is forgotten.
    assert lent(desk, 1.5) == [("open", "00", 1)]
