"""A process gives way as much as it is told to, with its session where it leads one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from covinz.config import Config

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
