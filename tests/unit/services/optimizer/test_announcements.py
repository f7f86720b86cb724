"""Who hears which correction, and when."""

from __future__ import annotations

import numpy as np
import pytest

from covinz import codec, keyexprs
from covinz.types import Correction, RetryAfter, Stored
from services.optimizer.doors import RETRY_AFTER_S
from services.optimizer.unsent import RETRY_S
from tests.fleets import closure, keyframe, make_fleet, session
from tests.optimizer_bench import Bench

FLEET = make_fleet(length=20)
PAIR = [keyframe("a", 0, 0), keyframe("b", 1, 0)]
BRIDGE = closure(PAIR[0].id, PAIR[1].id)


def test_an_agent_hears_of_its_first_keyframe_and_of_every_optimisation(bench: Bench) -> None:
    bench.begin()
    bench.read(FLEET.keyframes)
    first = bench.heard(2)
    for correction in first:
        np.testing.assert_array_equal(correction.T_map_odom, np.eye(4))
        assert correction.map_id == correction.keyframe.session
        assert not correction.jumped
    bench.bring(next(loop for loop in FLEET.loops if loop.query.agent != loop.cand.agent))
    bench.run()
    second = bench.heard(2)
    assert [c.map_id for c in second] == [session(0), session(0)]
    assert [c.jumped for c in second] == [False, True]
    assert {c.map_revision for c in second} == {1}
    snapshot = bench.snapshot()
    for correction in second:
        node = snapshot.keyframes.index(correction.keyframe)
        assert correction.keyframe.seq == 19
        np.testing.assert_allclose(
            correction.T_map_odom @ snapshot.T_odom_body[node],
            snapshot.T_map_body[node],
            atol=1e-9,
        )
    assert bench.heard_nothing_more()


def test_only_the_newest_session_of_an_agent_is_corrected(bench: Bench) -> None:
    bench.begin()
    bench.read([keyframe("a", 0, 0), keyframe("a", 1, 0), keyframe("b", 2, 0)])
    bench.read([keyframe("a", 0, 1)])
    assert [c.keyframe.session for c in bench.heard(2)] == [session(1), session(2)]
    bench.bring(closure(keyframe("b", 2, 0).id, keyframe("a", 0, 0).id))
    bench.run()
    (correction,) = bench.heard(1)
    assert (correction.keyframe.agent, correction.map_id) == ("b", session(0))
    bench.bring(closure(keyframe("a", 1, 0).id, keyframe("a", 0, 0).id))
    bench.run()
    assert [(c.keyframe.agent, c.map_id) for c in bench.heard(2)] == [
        ("a", session(0)),
        ("b", session(0)),
    ]
    assert bench.heard_nothing_more()


def test_a_session_whose_start_was_overtaken_is_corrected_all_the_same(bench: Bench) -> None:
    # Several uploads of a robot are under way at once: its old session may be logged after the
    # first keyframe of the one it is in.
    bench.begin()
    bench.read([keyframe("a", 1, 0), keyframe("a", 0, 0)])
    assert [c.keyframe.session for c in bench.heard(1)] == [session(0)]
    bench.read([keyframe("a", 1, seq) for seq in range(1, 6)])
    assert [c.keyframe.session for c in bench.heard(1)] == [session(1)]
    bench.read([keyframe("b", 2, 0)])
    bench.heard(1)
    bench.bring(closure(keyframe("b", 2, 0).id, keyframe("a", 1, 0).id))
    bench.run()
    assert [c.keyframe.segment for c in bench.heard(2)] == [
        keyframe("a", 1, 0).id.segment,
        keyframe("b", 2, 0).id.segment,
    ]
    assert bench.heard_nothing_more()


def test_the_last_correction_can_be_asked_for_even_after_a_restart(bench: Bench) -> None:
    bench.begin()
    assert bench.ask(keyexprs.agent_correction("a")) is None
    bench.read(PAIR)
    bench.bring(BRIDGE)
    bench.run()
    answer = bench.ask(keyexprs.agent_correction("b"))
    assert codec.decode(answer or b"", Correction).map_id == session(0)
    bench.restart()
    assert bench.ask(keyexprs.agent_correction("b")) == answer


def test_a_replay_sends_nothing_before_it_is_done(bench: Bench) -> None:
    bench.begin()
    bench.read(PAIR)
    bench.bring(BRIDGE)
    bench.run()
    bench.heard(4)
    bench.restart()
    bench.begin()
    bench.read(PAIR[:1], to_come=1)
    bench.read(PAIR[1:])
    assert bench.heard_nothing_more()
    bench.run()
    corrections = bench.heard(2)
    assert [c.map_id for c in corrections] == [session(0), session(0)]
    assert [c.jumped for c in corrections] == [False, False]
    assert {c.map_revision for c in corrections} == {2}


@pytest.mark.parametrize(
    "key", ["covinz/map/snapshot/nothing", "covinz/agent/*/down/correction", "covinz/map/other"]
)
def test_questions_without_an_answer_end_at_once(bench: Bench, key: str) -> None:
    assert bench.ask(key) is None


def test_corrections_wait_until_they_are_durable(bench: Bench) -> None:
    bench.begin()
    bench.read(PAIR)
    bench.heard(2)
    assert bench.bring(BRIDGE) == Stored()
    bench.set_writable(False)
    bench.run()
    answer = bench.bring(closure(PAIR[1].id, PAIR[0].id))
    assert answer == RetryAfter(RETRY_AFTER_S, "the server cannot write to its disk")
    status = bench.status()
    assert status.dirty
    assert status.counters["cannot_store.other"] == 1
    assert bench.optimizer.patience_s() == pytest.approx(RETRY_S)
    assert bench.heard_nothing_more()

    bench.now_s += RETRY_S
    bench.optimizer.handle([])
    assert bench.heard_nothing_more()
    bench.set_writable(True)
    bench.now_s += RETRY_S
    bench.optimizer.handle([])
    assert {c.keyframe.agent for c in bench.heard(2)} == {"a", "b"}
    assert not bench.status().dirty
    revision = bench.store.revision
    bench.restart()
    assert bench.store.revision == revision
    assert len(bench.store.corrections()) == 2
