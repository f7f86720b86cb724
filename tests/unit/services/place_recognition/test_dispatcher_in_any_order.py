from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from covinz.types import JobState, Lease, Outcome
from services.place_recognition.journal import Journal
from tests.dispatching import CONFIG, job, loop, make, rejection


class DispatcherMachine(RuleBasedStateMachine):
    """Workers ask, die, hang and answer in any order; the process crashes at any point."""

    @initialize()
    def open(self) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.journal = Journal(Path(self.folder.name) / "place_recognition.sqlite")
        self.desk = make(self.journal)
        self.now_s = 0.0
        self.num_jobs = 0
        self.leases: list[Lease] = []
        self.open_requests: set[str] = set()
        self.acked: dict[str, Outcome] = {}

    def settle(self) -> None:
        effects = self.desk.advance(self.now_s)
        self.journal.commit()
        for asker, lease in effects.granted:
            self.open_requests.remove(asker)
            assert asker.startswith(f"{lease.worker} ")
            assert lease.job.id not in self.acked
            assert 1 <= lease.attempt <= CONFIG.max_attempts
            self.leases.append(lease)
        for asker in effects.turned_away:
            self.open_requests.remove(asker)

    @rule()
    def add(self) -> None:
        self.desk.add(job(self.num_jobs))
        self.num_jobs += 1
        self.settle()

    @rule(worker=st.sampled_from("uvw"))
    def request(self, worker: str) -> None:
        asker = f"{worker} {len(self.open_requests)} {self.now_s}"
        self.now_s += 0.25
        self.open_requests.add(asker)
        self.desk.request(worker, asker, self.now_s)
        self.settle()

    @rule(worker=st.sampled_from("uvw"))
    def worker_dies(self, worker: str) -> None:
        self.desk.worker_gone(worker)
        self.settle()

    @rule(worker=st.sampled_from("uvw"))
    def worker_is_back(self, worker: str) -> None:
        self.desk.worker_back(worker)
        self.settle()

    @precondition(lambda self: self.num_jobs)
    @rule(data=st.data())
    def somebody_wants_it_again(self, data: st.DataObject) -> None:
        record = data.draw(st.sampled_from(self.desk.page(0).records))
        assert self.desk.retry(record.job.id) is (record.state is JobState.DEAD)
        self.settle()

    @rule(seconds=st.sampled_from([1.0, 5.0, 60.0]))
    def time_passes(self, seconds: float) -> None:
        self.now_s += seconds
        self.settle()

    @precondition(lambda self: self.leases)
    @rule(data=st.data(), closes=st.booleans())
    def outcome_comes(self, data: st.DataObject, closes: bool) -> None:
        # Of any lease ever given, so also late and twice.
        n = int(data.draw(st.sampled_from(self.leases)).job.id, 16)
        outcome = loop(n) if closes else rejection(n)
        fresh = self.desk.finish(outcome)
        assert fresh is (outcome.job_id not in self.acked)
        self.settle()
        self.acked.setdefault(outcome.job_id, outcome)

    @rule(replayed=st.integers(0, 100))
    def crash(self, replayed: int) -> None:
        self.journal.close()
        self.journal = Journal(Path(self.folder.name) / "place_recognition.sqlite")
        self.desk = make(self.journal)
        self.open_requests.clear()
        # Requests and outcomes may come in the middle of the replay; the rest follows at once.
        for n in range(self.num_jobs):
            if n == replayed and self.leases:
                self.desk.finish(rejection(int(self.leases[0].job.id, 16)))
                self.acked.setdefault(self.leases[0].job.id, rejection(0))
            self.desk.add(job(n))
        self.settle()

    @invariant()
    def every_job_is_in_one_state(self) -> None:
        page = self.desk.page(0)
        assert [r.job.id for r in page.records] == [job(n).id for n in range(self.num_jobs)]
        states = [r.state for r in page.records]
        assert states.count(JobState.PENDING) == self.desk.pending
        assert states.count(JobState.LEASED) == self.desk.leased
        for record in page.records:
            closed = record.state in (JobState.DONE, JobState.DEAD)
            assert closed is (record.outcome is not None)
            assert (record.state is JobState.DONE) is (record.job.id in self.acked)
            dead_after = CONFIG.max_attempts if record.state is JobState.DEAD else 0
            assert dead_after <= record.attempts <= CONFIG.max_attempts + 1
        assert sum(self.desk.counters.values()) - self.desk.counters["returned"] == sum(
            state in (JobState.DONE, JobState.DEAD) for state in states
        )

    @invariant()
    def nobody_waits_while_there_is_work(self) -> None:
        assert not (self.desk.pending and self.open_requests)

    def teardown(self) -> None:
        self.journal.close()
        self.folder.cleanup()


TestDispatcherMachine = DispatcherMachine.TestCase
TestDispatcherMachine.settings = settings(max_examples=15, stateful_step_count=25, deadline=None)
