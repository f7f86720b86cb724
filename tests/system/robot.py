"""A robot as a process of its own, to be killed: sends keyframes and says which are safe.

``python -m tests.system.robot ENDPOINT SPOOL COUNT [PLAN]`` prints the id of each keyframe once it
is on the disk, then "sent". Then, by plan:

- ``deliver``: prints "delivered" when the server has everything;
- ``leave``: ends at once;
- ``full``: nothing can be written to the disk until a line comes on the standard input. Prints
  "refused" for each of COUNT more keyframes, "empty" when the server has what was sent, and, after
  that line, the ids of COUNT more keyframes, then as ``deliver``.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from covinz import SpoolError
from covinz.agent import Agent
from tests.uploads import content


def main(endpoint: str, spool: str, count: str, plan: str = "deliver") -> None:
    """Send `count` keyframes and wait for a kill or for the server."""
    with Agent("a0", endpoint, Path(spool)) as agent:
        send(agent, range(int(count)))
        say("sent")
        if plan == "leave":
            return
        if plan == "full":
            with full_disk():
                send(agent, range(int(count), 2 * int(count)))
                agent.wait_delivered()
                say("empty")
                sys.stdin.readline()
            send(agent, range(int(count), 2 * int(count)))
        agent.wait_delivered()
        say("delivered")


def send(agent: Agent, seqs: range) -> None:
    """Send keyframes and say what became of them."""
    for seq in seqs:
        try:
            name = agent.send(content(seq, num_features=200))
            agent.wait_saved()
            say(str(name))
        except SpoolError:
            say("refused")


@contextmanager
def full_disk() -> Iterator[None]:
    """No file can be written beyond its first bytes."""
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))


def say(line: str) -> None:
    """One line to whoever started this process, at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
