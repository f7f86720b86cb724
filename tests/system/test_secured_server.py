"""A fleet with the commands of the guide: add to the roster, start, play over TLS, look, remove."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from covinz import client
from covinz.access.credentials import with_credentials
from covinz.bus import ZenohBus
from covinz.config import BusConfig
from covinz.run import free_port
from tests.processes import CHECKOUT

SMALL = CHECKOUT / "tests" / "system" / "small.yaml"
PATIENCE_S = 120.0
StartProgram = Callable[..., subprocess.Popen[str]]


def covinz(folder: Path, *arguments: str, module: str = "covinz.cli") -> tuple[int, str]:
    """Exit code and output of a command in a folder; settings of the caller's do not count."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("COVINZ__")}
    environment |= {"COLUMNS": "200", "PYTHONPATH": f"{CHECKOUT}:{CHECKOUT / 'agents'}"}
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=PATIENCE_S,
    )
    return done.returncode, done.stdout


@pytest.mark.slow
def test_the_commands_of_the_guide(tmp_path: Path, start_program: StartProgram) -> None:
    data = ("--data", "server")
    code, said = covinz(tmp_path, "up", "--listen", "0.0.0.0", *data)
    assert (code, "covinz roster add NAME --server HOST --data server" in said) == (1, True)

    where = ("--server", "127.0.0.1", "--port", str(free_port()))
    for robot in ("agent0", "agent1"):
        code, said = covinz(tmp_path, "roster", "add", robot, *where, *data)
        assert code == 0 and f"{robot}.covinz" in said
    assert covinz(tmp_path, "roster", "add", "anna", "--operator", *data)[0] == 0

    command = [sys.executable, "-m", "covinz.cli", "up", "--listen", "0.0.0.0"]
    start_program("up", [*command, "--data", str(tmp_path / "server")])
    own = tmp_path / "server" / "roster" / "server.covinz"
    bus = ZenohBus.open(with_credentials(BusConfig(), own))
    try:
        client.wait_idle(bus, timeout_s=PATIENCE_S)
    finally:
        bus.close()

    arguments = (str(SMALL), "--credentials", ".", "--spool", "spool", "--no-progress")
    code, said = covinz(tmp_path, *arguments, module="covinz_agents.play")
    assert code == 0, said
    for command_ in (("status",), ("why", "agent0"), ("export",)):
        code, said = covinz(tmp_path, *command_, "--credentials", "anna.covinz")
        assert code == 0, said
    code, said = covinz(tmp_path, "doctor", "--credentials", "anna.covinz")
    assert code == 0, said
    assert "agent0: not connected" in said and "keyframes stored" in said
    code, said = covinz(tmp_path, "doctor", "--credentials", "agent0.covinz")
    assert code == 0 and "agent0 has been corrected" in said
    # A robot's credentials show nothing of the server, and nothing is shown without any.
    code, said = covinz(tmp_path, "status", "--credentials", "agent0.covinz")
    assert (code, "no process answers" in said) == (1, True)
    code, said = covinz(tmp_path, "status", "--endpoint", f"tcp/127.0.0.1:{where[-1]}")
    assert (code, "needs credentials" in said) == (1, True)

    code, said = covinz(tmp_path, "roster", "list", *data)
    assert [name in said for name in ("agent0", "agent1", "anna", "server")] == [True] * 4
    assert covinz(tmp_path, "roster", "remove", "agent0", *data)[0] == 0
    # The router looks at its roster once a second, and starts anew.
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        code, said = covinz(tmp_path, "doctor", "--credentials", "agent0.covinz")
        if "agent0 was removed from its roster" in said:
            break
        assert time.monotonic() < deadline_s, said
    assert code == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("roster", "list"), "there is no roster in data/roster"),
        (("roster", "add", "r1"), "say where robots reach this server"),
        (("roster", "add", "R1", "--server", "h"), "cannot be a name"),
        (("roster", "remove", "r1"), "r1 is not in the roster: nobody"),
        (("status", "--credentials", "none.covinz"), "no usable credentials: cannot read none"),
        (("doctor", "--endpoint", "tls/127.0.0.1:9"), "needs credentials"),
        (("doctor", "--endpoint", "tcp/127.0.0.1:9"), "nobody listens there; is the server up?"),
    ],
)
def test_a_wrong_call_says_what_is_wrong(
    tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    code, said = covinz(tmp_path, *arguments)
    assert code == 1
    assert message in " ".join(said.split())
    assert "Traceback" not in said
