"""Plays robots of `benchmarks/load.py` in a process of its own: one bus session each.

Each sends at a steady rate, whatever the server does, with as many uploads under way as a robot's
window allows. Times are counted from the moment when a keyframe was due, so that a server that
falls behind cannot hide it. What a robot does not do here is its own work: features and the spool,
which are on its own machine.

    python -m benchmarks.load_robots --endpoint E --recordings DIR --robots 0:25 --rate 4 ...
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks import load_recordings
from benchmarks.load_recordings import Recordings, agent_name
from covinz import codec, keyexprs
from covinz.bus import ZenohBus
from covinz.config import AgentConfig, BusConfig
from covinz.types import Correction, Duplicate, NeedCamera, RetryAfter, Stored

# After an unanswered upload. [s]
_PAUSE_S = 0.1


@dataclass(frozen=True, slots=True)
class Plan:
    """What the robots of a process do.

    Attributes:
        start_s: When they begin, of the monotonic clock.
        rate_hz: Keyframes of each a second.
        count: Keyframes of each in all.
    """

    start_s: float
    rate_hz: float
    count: int


@dataclass(slots=True)
class Robot:
    """One robot on a bus of its own.

    Attributes:
        due_s: When each keyframe was due.
        acked_s: When the server had it; None if it refused it.
        corrected: (time, keyframe) of each correction.
        answers: By what they were.
    """

    number: int
    bus: ZenohBus
    recordings: Recordings
    plan: Plan
    due_s: dict[int, float] = field(default_factory=dict)
    acked_s: dict[int, float] = field(default_factory=dict)
    corrected: list[tuple[float, int]] = field(default_factory=list)
    answers: Counter[str] = field(default_factory=Counter)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _next: int = 0

    def on_correction(self, key: str, payload: bytes) -> None:
        """Note a correction."""
        seq = codec.decode(payload, Correction).keyframe.seq
        self.corrected.append((time.monotonic(), seq))

    def upload(self) -> None:
        """One of the threads that upload: until all is sent."""
        while (seq := self._take()) is not None:
            due_s = self.due_s[seq]
            # Made while there is time.
            payload = self.recordings.played(self.number, seq)
            pause_s = due_s - time.monotonic()
            if pause_s > 0:
                time.sleep(pause_s)
            if self._deliver(payload):
                self.acked_s[seq] = time.monotonic()

    def _take(self) -> int | None:
        with self._lock:
            if self._next >= self.plan.count:
                return None
            seq, self._next = self._next, self._next + 1
            # Robots are not in step.
            phase = (self.number * 0.618034) % 1.0
            self.due_s[seq] = self.plan.start_s + (seq + phase) / self.plan.rate_hz
            return seq

    def _deliver(self, payload: bytes) -> bool:
        """Send until there is a final answer; whether the keyframe is safe."""
        agent = agent_name(self.number)
        while True:
            replies = self.bus.ask(keyexprs.agent_keyframe(agent), payload)
            answer = codec.decode_upload_reply(replies[0]) if replies else None
            with self._lock:
                self.answers[type(answer).__name__] += 1
            match answer:
                case Stored() | Duplicate():
                    return True
                case NeedCamera(camera_hash):
                    camera = self.recordings.cameras[camera_hash]
                    self.bus.ask(keyexprs.agent_camera(agent), camera)
                case RetryAfter(seconds=seconds):
                    time.sleep(seconds)
                case None:
                    time.sleep(_PAUSE_S)
                case _:
                    return False


def play(robots: list[Robot], window: int) -> None:
    """Let all robots send all they have."""
    threads = [threading.Thread(target=robot.upload) for robot in robots for _ in range(window)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def report(robots: list[Robot]) -> dict[str, Any]:
    """What was sent, and when what came back."""
    answers: Counter[str] = Counter()
    for robot in robots:
        answers.update(robot.answers)
    return {
        "answers": dict(answers),
        "robots": [
            {
                "number": robot.number,
                "due_s": [robot.due_s[seq] for seq in range(len(robot.due_s))],
                "acked_s": [robot.acked_s.get(seq) for seq in range(len(robot.due_s))],
                "corrected": robot.corrected,
            }
            for robot in robots
        ],
    }


def main() -> int:
    """Play; listen for corrections a little longer."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--endpoint", required=True)
    parser.add_argument("--recordings", type=Path, required=True)
    parser.add_argument("--robots", required=True, metavar="FIRST:END")
    parser.add_argument("--start", type=float, required=True, help="of the monotonic clock [s]")
    parser.add_argument("--rate", type=float, required=True, help="keyframes of each a second")
    parser.add_argument("--count", type=int, required=True, help="keyframes of each")
    parser.add_argument("--linger", type=float, default=0.0, help="listen so much longer [s]")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    recordings = load_recordings.read(arguments.recordings)
    plan = Plan(arguments.start, arguments.rate, arguments.count)
    first, end = map(int, arguments.robots.split(":"))
    robots = []
    with ExitStack() as stack:
        for number in range(first, end):
            bus = stack.enter_context(
                closing(ZenohBus.open(BusConfig(endpoint=arguments.endpoint)))
            )
            robots.append(Robot(number, bus, recordings, plan))
            key = keyexprs.agent_correction(agent_name(number))
            stack.enter_context(closing(bus.subscribe(key, robots[-1].on_correction)))
        play(robots, AgentConfig().window)
        time.sleep(arguments.linger)
        arguments.out.write_text(json.dumps(report(robots)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
