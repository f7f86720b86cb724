"""Stop signals: the event is set once and for all, however many signals come at whatever moment."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import os, signal, threading
from covinz.signals import stop_event

stop = stop_event()

def ask():
    for _ in range(2000):
        os.kill(os.getpid(), signal.{name})

threading.Thread(target=ask).start()
while not stop.wait(1e-6):
    pass
print("stopped", flush=True)
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_burst_of_signals_stops_a_program_that_waits(name: str) -> None:
    command = [sys.executable, "-c", PROGRAM.format(name=name)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "stopped\n", "")
