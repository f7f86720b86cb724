"""The network of a case: started, entered, its weather changed; see `link`."""

from __future__ import annotations

import ctypes
import dataclasses
import json
import os
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from benchmarks.drill.link import FAIR, Weather
from benchmarks.drill.server import CHECKOUT
from covinz.supervisor import child_environment, die_with_parent

_CLONE_NEWNET = 0x40000000
_CLONE_NEWNS = 0x00020000
# Of robots and cable.
_NICENESS = -10


def why_not() -> str | None:
    """Why there can be no network of our own here; None when there can."""
    missing = [name for name in ("ip", "nsenter", "unshare") if shutil.which(name) is None]
    if missing:
        return f"{', '.join(missing)} not installed"
    if not os.access("/dev/net/tun", os.R_OK | os.W_OK):
        return "no access to /dev/net/tun"
    return _refused("--net")


def why_no_mounts() -> str | None:
    """Why no small disk can be mounted here; None when one can."""
    missing = [name for name in ("unshare", "mount") if shutil.which(name) is None]
    return f"{', '.join(missing)} not installed" if missing else _refused("--mount")


def _refused(kind: str) -> str | None:
    tried = subprocess.run(["unshare", kind, "true"], capture_output=True, text=True, check=False)
    return (
        None if tried.returncode == 0 else f"no right to `unshare {kind}`: {tried.stderr.strip()}"
    )


def own_mounts() -> None:
    """What this process and its children mount from now on ends with them; raises OSError."""
    _call("unshare", _CLONE_NEWNS)
    subprocess.run(["mount", "--make-rprivate", "/"], check=True)


def on_other_hardware() -> None:
    """Run in a child before its program: it does not wait for the server's processors, if it may.

    Robots and cables have hardware of their own. It also ends with its parent.
    """
    die_with_parent()
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)


class Network:
    """Two namespaces and what is between them; ends with the block."""

    def __init__(self, seed: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.drill.link", str(seed)],
            cwd=CHECKOUT,
            env=child_environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=on_other_hardware,
        )
        self._server, self._robots = self._read()["ns"]

    def __enter__(self) -> Network:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._process.kill()
        self._process.communicate()

    def enter(self) -> None:
        """Move this process to the server's side; before it has other threads."""
        file = os.open(Path(self._server), os.O_RDONLY)
        try:
            _call("setns", file, _CLONE_NEWNET)
        finally:
            os.close(file)

    @property
    def on_robots_side(self) -> tuple[str, ...]:
        """What a command begins with that is to run on the robots' side."""
        return ("nsenter", f"--net={self._robots}", "--")

    def change(self, weather: Weather = FAIR) -> dict[str, int]:
        """Other weather from now on; returns how many packets were carried and dropped so far."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(dataclasses.asdict(weather)) + "\n")
        self._process.stdin.flush()
        return self._read()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise OSError("the network between robots and server could not be made")
        found: dict[str, Any] = json.loads(line)
        return found


def _call(name: str, *arguments: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if getattr(libc, name)(*arguments) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{name}: {os.strerror(number)}")
