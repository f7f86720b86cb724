"""A process gives way as it is told to, with its session where it leads one; turns are short."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import pytest

from covinz.config import Config
from covinz.machine import THIS_MACHINE
from covinz.niceness import LONG_TURNS_S, SHORT_TURNS_S, take_turns
from tests.turns import turn_s

CHECKOUT = Path(__file__).parents[3]
SHOW = """
import os
from covinz.niceness import give_way
for niceness in (7, 3):
    give_way(niceness)
    print(os.getpriority(os.PRIO_PROCESS, 0))
"""


@pytest.mark.parametrize("leads_session", [True, False])
def test_niceness_only_grows(leads_session: bool) -> None:
    mine = os.getpriority(os.PRIO_PROCESS, 0)
    group = Path("/proc/self/autogroup")
    before = group.read_text() if group.exists() else ""
    shown = subprocess.run(
        [sys.executable, "-c", SHOW],
        cwd=CHECKOUT,
        check=True,
        capture_output=True,
        text=True,
        start_new_session=leads_session,
    )
    assert shown.stdout.split() == [str(max(7, mine))] * 2
    # What shares the test's session is as it was.
    assert (group.read_text() if group.exists() else "") == before


def test_robots_are_served_before_loops_are_solved() -> None:
    niceness = Config().niceness
    assert niceness.router == niceness.ingest == 0
    assert niceness.ingest < niceness.place_recognition < niceness.loop_solver
    assert niceness.optimizer < niceness.loop_solver


def test_only_threads_that_compute_take_long_turns() -> None:
    found = dict[str, tuple[float, int]]()

    def look(name: str) -> None:
        thread = threading.get_native_id()
        found[name] = (turn_s(thread), os.getpriority(os.PRIO_PROCESS, thread))

    def start() -> None:
        take_turns(SHORT_TURNS_S)
        os.nice(2)
        for name in ("answers", "computes"):
            thread = THIS_MACHINE.thread(partial(look, name), name, computes=name == "computes")
            thread.start()
            thread.join()

    # What it starts from is not this test's own thread, which goes on as it was.
    before = turn_s(0)
    starter = threading.Thread(target=start)
    starter.start()
    starter.join()
    niceness = min(os.getpriority(os.PRIO_PROCESS, 0) + 2, 19)
    assert {nice for _, nice in found.values()} == {niceness}
    assert found["answers"][0] == pytest.approx(SHORT_TURNS_S)
    assert found["computes"][0] == pytest.approx(LONG_TURNS_S)
    assert turn_s(0) == before
