"""Heartbeats between real processes, and who counts as silent."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from covinz.beats import BIRTH_S, VARIABLE, BeatListener, Beats, Hearts

WAIT_S = 20.0
CHECKOUT = Path(__file__).resolve().parents[3]


def test_the_listener_knows_who_sent_it() -> None:
    program = "from covinz.beats import Beats; Beats.of_process().send()"
    with closing(BeatListener()) as listener:
        Beats(listener.environment[VARIABLE]).send()
        assert listener.receive(WAIT_S) == os.getpid()
        child = subprocess.Popen(
            [sys.executable, "-c", program],
            env={**os.environ, **listener.environment},
            cwd=CHECKOUT,
        )
        assert child.wait(WAIT_S) == 0
        assert listener.receive(WAIT_S) == child.pid
        assert listener.receive(0.0) is None


def test_it_speaks_to_a_socket_in_the_file_system_as_systemd_has(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        Beats(str(tmp_path / "notify")).send()
        assert manager.recv(100) == b"WATCHDOG=1"


@pytest.mark.parametrize("address", [None, "", "vsock:2:1234", "@covinz-nobody", "/no/such"])
def test_without_a_listener_nothing_happens(address: str | None) -> None:
    Beats(address).send()


def test_a_listener_that_does_not_listen_blocks_nobody() -> None:
    with closing(BeatListener()) as listener:
        beats = Beats(listener.environment[VARIABLE])
        for _ in range(1000):
            beats.send()
        assert listener.receive(WAIT_S) == os.getpid()


def test_a_process_is_silent_after_its_last_heartbeat() -> None:
    hearts = Hearts(silent_s=8.0)
    hearts.born(1, 0.0)
    hearts.born(2, 0.0)
    for second in range(1, 20):
        assert hearts.heard(1, float(second)) == set()
    for second in range(20, 28):
        assert hearts.heard(3, float(second)) == set()
    assert hearts.heard(None, 28.0) == {1}
    hearts.died(1)
    assert hearts.heard(1, 29.0) == set()


def test_a_process_has_time_to_start() -> None:
    hearts = Hearts(silent_s=8.0)
    hearts.born(1, 0.0)
    for second in range(1, int(BIRTH_S) + 1):
        assert hearts.heard(None, float(second)) == set()
    assert hearts.heard(None, BIRTH_S + 1) == {1}


def test_who_did_not_listen_blames_nobody() -> None:
    hearts = Hearts(silent_s=8.0)
    hearts.heard(None, 0.0)
    hearts.born(1, 0.0)
    assert hearts.heard(1, 1.0) == set()
    assert hearts.heard(None, 1000.0) == set()  # stopped, and going on
    assert hearts.heard(None, 1003.0) == set()
    assert hearts.heard(None, 1007.0) == set()
    assert hearts.heard(None, 1009.0) == {1}
