"""Two robots under one id are told from one robot that was restarted."""

from __future__ import annotations

import pytest

from covinz.types import Gap, RetryAfter
from services.ingest.twins import GONE_S, TURNS, Twins
from tests.uploads import OTHER_SESSION, SESSION, keyframe


class Bench:
    def __init__(self) -> None:
        self.now_s = 0.0
        self.twins = Twins(lambda: self.now_s)
        self.seqs = {SESSION: 0, OTHER_SESSION: 0}

    def send(self, session: str, agent: str = "a0") -> bool:
        """Whether the next keyframe of a session may enter the log."""
        self.now_s += 0.25
        seq = self.seqs[session] = self.seqs[session] + 1
        answer = self.twins.judge(agent, keyframe(seq, agent, session))
        if answer is not None:
            assert answer == RetryAfter(
                5.0,
                f"another robot sends as {agent}, session {SESSION}: give each an id of its own",
            )
        return answer is None


@pytest.fixture
def bench() -> Bench:
    return Bench()


def both_send(bench: Bench) -> None:
    for _ in range(TURNS + 1):
        bench.send(SESSION)
        bench.send(OTHER_SESSION)


def test_of_two_robots_the_later_one_waits(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    both_send(bench)
    assert not bench.send(OTHER_SESSION)
    assert bench.send(SESSION)
    assert not bench.send(OTHER_SESSION)
    assert bench.twins.counters == {"twins.a0": 1}
    assert caplog.text.count("two robots send as a0") == 1


def test_a_gap_waits_too_and_other_robots_do_not(bench: Bench) -> None:
    both_send(bench)
    assert bench.twins.judge("a0", Gap("a0", OTHER_SESSION, 90, 91, "full")) is not None
    assert bench.twins.judge("a0", Gap("a0", SESSION, 90, 91, "full")) is None
    assert bench.send(OTHER_SESSION, agent="a1")


def test_when_the_first_one_is_gone_the_other_one_is_taken(bench: Bench) -> None:
    both_send(bench)
    assert not bench.send(OTHER_SESSION)
    bench.now_s += GONE_S + 1
    assert all(bench.send(OTHER_SESSION) for _ in range(20))
    assert bench.twins.counters == {}


def test_a_restarted_robot_is_one_robot(bench: Bench) -> None:
    for _ in range(20):
        assert bench.send(SESSION)
    # What is left of the old session comes first, but four uploads are under way at once.
    order = [OTHER_SESSION, SESSION, OTHER_SESSION, SESSION, SESSION, OTHER_SESSION, SESSION]
    assert all(bench.send(session) for session in order)
    assert all(bench.send(OTHER_SESSION) for _ in range(50))
    assert bench.twins.counters == {}


def test_many_resets_of_the_odometry_are_one_robot(bench: Bench) -> None:
    for number in range(100):
        session = f"01JD{number:022d}"
        bench.seqs[session] = 0
        assert all(bench.send(session) for _ in range(3))
    assert bench.twins.counters == {}
