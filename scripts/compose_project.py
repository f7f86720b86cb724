"""A compose project of its own name and port, driven by the real commands."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

# Not the name that a server of the user runs under.
IMAGE = "covinz:check"
CHECKOUT = Path(__file__).resolve().parents[1]
# Longer than anything here takes on a busy machine. [s]
PATIENCE_S = 1200.0
POLL_S = 0.2

T = TypeVar("T")


class CheckFailed(RuntimeError):
    """The server does not do what it promises; the message says what."""


class ComposeProject:
    """The server of docker-compose.yml under a name of its own.

    Args:
        command: The compose program, e.g. ``["docker", "compose"]``.
        name: Of the project: prefix of containers, volumes and network.
        port: Loopback port for robots.
        folder: For the override file.
        settings: ``COVINZ__SECTION__FIELD`` for all services.
        secured: With docker-compose.tls.yml on top.
    """

    def __init__(
        self,
        command: Sequence[str],
        name: str,
        port: int,
        folder: Path,
        settings: Mapping[str, str],
        secured: bool = False,
    ) -> None:
        override = folder / "override.json"
        services = ("router", "ingest", "place_recognition", "loop_solver", "optimizer")
        override.write_text(
            json.dumps({"services": {name: {"environment": dict(settings)} for name in services}})
        )
        files = ["docker-compose.yml", *(["docker-compose.tls.yml"] if secured else [])]
        options = [word for file in files for word in ("--file", str(CHECKOUT / file))]
        options += ["--file", str(override), "--project-name", name]
        self._command = [*command, *options]
        self._environ = dict(
            os.environ, COVINZ_IMAGE=IMAGE, COVINZ_LISTEN="127.0.0.1", COVINZ_PORT=str(port)
        )

    def build(self) -> None:
        """Build the image."""
        self._run("build")

    def up(self, workers: int, *, wait: bool = True) -> None:
        """Start what is not running, or change the number of loop solvers.

        With `wait` until the engine has found all containers healthy.
        """
        options = ["--detach", "--scale", f"loop_solver={workers}"]
        self._run("up", *options, *(["--wait"] if wait else []))

    def down(self, *, volumes: bool) -> None:
        """Stop and remove the containers, and with `volumes` all that they kept."""
        self._run("down", *(["--volumes", "--remove-orphans"] if volumes else []))

    def roster_add(self, *arguments: str) -> str:
        """Let a robot or operator in; returns its credentials."""
        return self._output("run", "--rm", "-T", "roster", "add", *arguments, "--out", "-")

    def logs(self) -> str:
        """What all processes have written lately."""
        return self._output("logs", "--no-color", "--tail", "20")

    def containers(self, service: str = "") -> list[str]:
        """Ids of the running containers, of one service or of all."""
        return self._output("ps", "--quiet", *filter(None, [service])).split()

    def _run(self, *arguments: str) -> None:
        program = subprocess.run(
            [*self._command, *arguments],
            env=self._environ,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        if program.returncode != 0:
            sys.stderr.write(program.stdout[-5000:])
            raise CheckFailed(f"compose {' '.join(arguments)} ended with {program.returncode}")

    def _output(self, *arguments: str) -> str:
        command = [*self._command, *arguments]
        return subprocess.check_output(command, env=self._environ, text=True)


def inspect(container: str) -> Any:
    """What the engine knows of a container or image."""
    (found,) = json.loads(subprocess.check_output(["docker", "inspect", container], text=True))
    return found


def kill_process(container: str) -> None:
    """End the process in a container like a crash does (the child of its tini)."""
    program = "kill -KILL $(cat /proc/1/task/1/children)"
    subprocess.run(["docker", "exec", container, "sh", "-c", program], check=True)


def memory(containers: Sequence[str]) -> list[str]:
    """``NAME used / limit`` of running containers."""
    form = "{{.Name}} {{.MemUsage}}"
    command = ["docker", "stats", "--no-stream", "--format", form, *containers]
    return sorted(subprocess.check_output(command, text=True).splitlines())


def until(what: str, look: Callable[[], T | None], patience_s: float = PATIENCE_S) -> T:
    """What `look` finds as soon as it finds something; CheckFailed when it takes too long."""
    deadline = time.monotonic() + patience_s
    pause = threading.Event()
    while (found := look()) is None:
        if time.monotonic() > deadline:
            raise CheckFailed(f"waited {patience_s:.0f} s in vain: {what}")
        pause.wait(POLL_S)
    return found
