"""A simulated robot: drives around the ring and hands keyframes to a real `Agent`."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

from covinz.agent import Agent
from covinz.bus import Bus
from covinz.config import Config
from covinz.spool import SpoolError
from covinz.types import Array, Correction, KeyframeId, SegmentId
from tests.simulation import world
from tests.simulation.machine import EPOCH_NS, SimulatedMachine
from tests.simulation.plan import Plan


class Robot:
    """What the world knows of a robot, over all runs of its process.

    Attributes:
        sent: Pose of every keyframe that `Agent.send` has returned for and the disk has.
        forgiven: Those that may be missing: they may have been acknowledged by a log that was lost.
        agent: Of the current run.
    """

    def __init__(self, number: int, plan: Plan, config: Config) -> None:
        self.name = f"robot{number}"
        self.sent: dict[KeyframeId, Array] = {}
        self.forgiven: set[KeyframeId] = set()
        self._num_logs_lost = 0
        self.agent: Agent | None = None
        self._plan = plan
        self._config = config
        self._draw = random.Random(f"robot {plan.seed} {number}")
        self._place = 2 * number
        self._left = plan.num_keyframes
        self._complain: Callable[[str], object] = lambda _: None

    def main(self, machine: SimulatedMachine, bus: Bus, folder: Path) -> int:
        """The robot's program: drive, then stay and listen."""
        self._complain = machine.scheduler.fail
        try:
            agent = Agent(
                self.name,
                bus,
                folder / "spool.sqlite",
                self._config,
                on_correction=self._on_correction,
                machine=machine,
            )
        except SpoolError:
            return 1
        self.agent = agent
        try:
            self._drive(machine, agent)
        finally:
            agent._spool.close()  # as the operating system does when a process dies
        return 0

    def _drive(self, machine: SimulatedMachine, agent: Agent) -> None:
        while self._left:
            machine.sleep(self._plan.period_s * self._draw.uniform(0.2, 1.8))
            if self._draw.random() < self._plan.resets:
                agent.new_session()
            self._send(agent)
        while True:
            machine.sleep(1000.0)

    @property
    def is_done(self) -> bool:
        """Everything was sent and acknowledged."""
        return not self._left and self.agent is not None and not self.agent.pending

    def knows(self) -> tuple[SegmentId, Correction | None]:
        """The segment that it is in, and its correction."""
        assert self.agent is not None
        return self._segment, self.agent.correction

    def log_is_lost(self) -> None:
        """What has been sent, or is being sent, may be gone with the server's disk."""
        self._num_logs_lost += 1
        self.forgiven.update(self.sent)

    def _send(self, agent: Agent) -> None:
        self._place += 1
        num_lost_before = self._num_logs_lost
        self._left -= 1
        stamp_ns = EPOCH_NS + self._place * 10**9
        content = world.content(agent.session, self._place, stamp_ns)
        try:
            name = agent.send(content)
        except SpoolError:
            return  # the disk is full, and the robot knows
        if agent.wait_saved():  # a process that hung may go on before its disk does
            self.sent[name] = content.T_odom_body
            # It may have been uploaded and lost before this thread went on.
            if self._num_logs_lost > num_lost_before:
                self.forgiven.add(name)

    def _on_correction(self, correction: Correction) -> None:
        """A correction is for this robot and of its session."""
        name = correction.keyframe
        if self.agent is not None and name.segment != self._segment:
            self._complain(f"{self._segment} got a correction of {name.segment}")
        if name not in self.sent:
            self._complain(f"{self.name} got a correction of {name}, which it never sent")

    @property
    def _segment(self) -> SegmentId:
        assert self.agent is not None
        return SegmentId(self.name, self.agent.session)
