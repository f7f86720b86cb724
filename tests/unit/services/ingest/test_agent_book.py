"""What ingest remembers of each agent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from covinz import codec, keyexprs
from covinz.machine import ThisMachine
from covinz.memory_bus import Hub
from covinz.types import Status
from services.ingest.agent_book import MAX_AGENTS, AgentBook
from tests.uploads import CAMERA, OTHER_SESSION, keyframe

NOW_NS = 10**18


class Machine(ThisMachine):
    time_ns = NOW_NS

    def now_ns(self) -> int:
        return self.time_ns


@pytest.fixture
def machine() -> Machine:
    return Machine()


@pytest.fixture
def book(machine: Machine) -> AgentBook:
    return AgentBook("ingest", min_features=3, machine=machine)


def test_the_quickest_keyframe_and_the_last_arrival(book: AgentBook, machine: Machine) -> None:
    for seq, age_s in enumerate((9.0, 2.0, 5.0)):
        book.stored(replace(keyframe(seq), stamp_ns=NOW_NS - int(age_s * 1e9)))
    machine.time_ns += 4 * 10**9
    found = book.status("a0").counters
    assert found["youngest_keyframe_s"] == pytest.approx(2.0, abs=1e-6)
    assert found["since_last_keyframe_s"] == pytest.approx(4.0, abs=1e-6)


def test_stamps_features_motion_and_sessions_are_counted(book: AgentBook) -> None:
    first = keyframe(0)
    book.stored(first)
    book.stored(replace(keyframe(2), stamp_ns=first.stamp_ns - 1))
    book.stored(keyframe(1, num_features=2))  # comes late, and its stamp is after that of 2
    book.stored(replace(keyframe(3), T_odom_body=keyframe(1).T_odom_body))
    book.stored(keyframe(0, session=OTHER_SESSION))
    found = book.status("a0")
    assert found.cursor == 5
    counters = {name: found.counters[name] for name in ("keyframes", "few_features", "still")}
    assert counters == {"keyframes": 5.0, "few_features": 1.0, "still": 1.0}
    assert found.counters["sessions"] == 2 and found.counters["stamps_back"] == 2


def test_refusals_and_calibrations_are_the_agents_own(book: AgentBook) -> None:
    book.refused("a0", "malformed")
    book.registered("a0", CAMERA)
    book.registered("a1", replace(CAMERA, params=np.array([5.0, 5.0, 320.0, 240.0])))
    assert book.status("a0").counters == {"rejected.malformed": 1.0}
    assert book.status("a1").counters == {"odd_calibration.focal_length": 1.0}
    assert book.status("a2").counters == {}


def test_names_without_end_take_no_memory_without_end(book: AgentBook) -> None:
    for number in range(2 * MAX_AGENTS):
        book.refused(f"a{number}", "malformed")
    assert book.status(f"a{MAX_AGENTS - 1}").counters
    assert not book.status(f"a{MAX_AGENTS}").counters


def test_it_answers_on_the_bus_and_to_no_wildcard(book: AgentBook) -> None:
    hub = Hub()
    server, agent = hub.join(), hub.join()
    server.answer(keyexprs.AGENT_STATUSES, book.answer)
    book.refused("a0", "malformed")
    (reply,) = agent.ask(keyexprs.agent_status("a0"))
    status = codec.decode(reply, Status)
    assert status.counters == {"rejected.malformed": 1.0} and status.now_ns == NOW_NS
    assert agent.ask(keyexprs.AGENT_STATUSES) == []
