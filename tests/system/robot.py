"""A robot as a process of its own, to be killed: sends keyframes and says which are safe.

``python -m tests.system.robot ENDPOINT SPOOL COUNT`` prints the id of each keyframe once it is on
the disk, then "sent", and "delivered" when the server has everything.
"""

from __future__ import annotations

import sys
from pathlib import Path

from covinz.agent import Agent
from tests.uploads import content


def main(endpoint: str, spool: str, count: str) -> None:
    """Send `count` keyframes and wait for a kill or for the server."""
    with Agent("a0", endpoint, Path(spool)) as agent:
        for seq in range(int(count)):
            name = agent.send(content(seq, num_features=200))
            agent.wait_saved()
            say(str(name))
        say("sent")
        agent.wait_delivered()
        say("delivered")


def say(line: str) -> None:
    """One line to whoever started this process, at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
