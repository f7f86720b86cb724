"""A robot of the drill, as a process of its own that may be killed, frozen or cut off.

It hands over recorded keyframes as a front-end does: when they are due, whatever becomes of the
uploads. It says what happens line by line, as JSON, and ends when its standard input does.

    python -m benchmarks.drill.robot AGENT --keyframes DIR --spool FILE --way FILE|ENDPOINT ...

What it says, with the time of the monotonic clock, which all processes of a machine share:

    {"open": uploads that wait in the spool}
    {"sent": id, "number": ..., "block_ms": how long `send` took}
    {"refused": number, "block_ms": ...}  `send` raised SpoolError; the keyframe is tried again
    {"acked": keyframes of its own and of earlier runs}
    {"done": keyframes sent}              all of them are acknowledged
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

from benchmarks.drill.recording import Recording, read
from covinz.access.credentials import SUFFIX
from covinz.agent import Agent
from covinz.spool import SpoolError
from covinz.types import KeyframeContent

# How often the acknowledgements are counted. [s]
_TICK_S = 0.01
# A keyframe that the spool refused is tried again after this long. [s]
_RETRY_S = 0.1


class Voice:
    """Lines to whoever started this process, from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()

    def say(self, **what: Any) -> None:
        """One line, at once."""
        with self._lock:
            sys.stdout.write(json.dumps({**what, "t": time.monotonic()}) + "\n")
            sys.stdout.flush()


class Robot:
    """Sends a recording and counts what is acknowledged."""

    def __init__(self, agent: Agent, voice: Voice) -> None:
        self._agent = agent
        self._voice = voice
        self._handed_over = agent.pending
        self._done = threading.Event()
        self._counting = threading.Thread(target=self._count, daemon=True)
        voice.say(open=self._handed_over)
        self._counting.start()

    def send(self, number: int, content: KeyframeContent) -> None:
        """Hand a keyframe over; one that the spool refuses is tried until it is taken."""
        while True:
            began = time.monotonic()
            try:
                name = self._agent.send(content)
            except SpoolError as error:
                self._voice.say(refused=number, block_ms=_since_ms(began), why=str(error))
                self._done.wait(_RETRY_S)
                continue
            block_ms = _since_ms(began)
            self._handed_over += 1
            self._voice.say(sent=str(name), number=number, block_ms=block_ms)
            return

    def finish(self, sent: int) -> None:
        """Wait until the server has everything."""
        self._agent.wait_delivered()
        self._done.set()
        self._counting.join()
        self._voice.say(done=sent)

    def _count(self) -> None:
        said = -1
        while not self._done.wait(_TICK_S):
            acked = self._handed_over - self._agent.pending
            if acked > said:
                said = acked
                self._voice.say(acked=acked)
        self._voice.say(acked=self._handed_over)


def play(agent: Agent, recording: Recording, arguments: argparse.Namespace, voice: Voice) -> None:
    """Send the recording from `first` on, in real time or each when the one before is acked."""
    robot = Robot(agent, voice)
    numbers = range(arguments.first, len(recording.contents))
    began = time.monotonic()
    pause = threading.Event()
    for number in numbers:
        if arguments.rate:
            due = began + (number - arguments.first) / arguments.rate
            pause.wait(max(0.0, due - time.monotonic()))
        if number == arguments.reset_at:
            agent.new_session()
        robot.send(number, recording.contents[number])
        if not arguments.rate:
            agent.wait_delivered()
    robot.finish(len(numbers))


def main() -> None:
    """Play one robot."""
    arguments = parser().parse_args()
    recording = read(arguments.keyframes, arguments.agent)
    secured = arguments.way.endswith(SUFFIX)
    with Agent(
        arguments.agent,
        Path(arguments.way) if secured else arguments.way,
        arguments.spool,
        # A run of the odometry that was begun anew has a session of its own.
        session=None if arguments.first else recording.session,
    ) as agent:
        play(agent, recording, arguments, Voice())
        sys.stdin.read()


def _since_ms(began: float) -> float:
    return 1e3 * (time.monotonic() - began)


def parser() -> argparse.ArgumentParser:
    """Arguments of a robot."""
    made = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    made.add_argument("agent", help="whose keyframes")
    made.add_argument("--keyframes", type=Path, required=True, help="folder of the recording")
    made.add_argument("--spool", type=Path, required=True)
    made.add_argument("--way", required=True, help="endpoint, or file NAME.covinz")
    made.add_argument("--rate", type=float, help="keyframes per second; without, in lockstep")
    made.add_argument("--first", type=int, default=0, help="number of the first keyframe")
    made.add_argument("--reset-at", type=int, help="the odometry begins anew at this keyframe")
    return made


if __name__ == "__main__":
    main()
