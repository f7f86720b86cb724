"""Plays the robots of a scenario: each sends its keyframes through its own `covinz.agent.Agent`."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from covinz import codec
from covinz.access.credentials import SUFFIX
from covinz.agent import Agent
from covinz.config import Config, validate
from covinz.scenario import Scenario
from covinz.types import Keyframe, KeyframeContent, KeyframeId, Rejected
from covinz.ulid import ulid
from covinz_agents.drift import seed_of
from covinz_agents.source import Frame
from covinz_agents.staging import OnRendering, Part, stage

# Keyframes whose features are computed before they are due.
_READ_AHEAD = 4
# How often progress is looked at while nothing ends. [s]
_TICK_S = 0.1


class NotDelivered(RuntimeError):
    """The server stopped acknowledging, or playing was stopped; the spool keeps the rest."""


@dataclass(frozen=True, slots=True)
class PlayOptions:
    """How to play.

    Attributes:
        endpoint: Where the server's router listens.
        spool: Folder for the robots' spools.
        results: Folder for the ground truth of rendered robots and the plan of their world.
        rate: Multiple of real time, all robots starting at once; None: as fast as the server
            acknowledges.
        lockstep: One keyframe at a time in stamp order across robots (ties: by id), each only
            when the one before is acknowledged, in sessions that depend on scenario and robot
            alone: the server's log is the same, bit by bit, every time.
        patience_s: Give up when the server acknowledged nothing for so long.
        credentials: Folder with a file ROBOT.covinz for each; None: the server asks for none.
    """

    endpoint: str
    spool: Path
    results: Path
    rate: float | None = None
    lockstep: bool = False
    patience_s: float = 120.0
    credentials: Path | None = None


@dataclass(slots=True, eq=False)
class Robot:
    """A robot being played.

    Attributes:
        part: Its source and what it sends.
        agent: Its link to the server.
        sent: Keyframes handed over so far.
        sent_bytes: Their size on the wire.
        rejected: Keyframes that the server refused for good.
    """

    part: Part
    agent: Agent
    rejected: list[KeyframeId]
    sent: int = 0
    sent_bytes: int = 0

    @property
    def id(self) -> str:
        """Its agent id."""
        return self.part.id

    @property
    def keyframes(self) -> Sequence[Frame]:
        """Frames that it sends."""
        return self.part.keyframes

    @property
    def acked(self) -> int:
        """Keyframes that the server has, or refused."""
        return max(0, self.sent - self.agent.pending)


Report = Callable[[Sequence[Robot]], None]


def lockstep_session(scenario: str, agent_id: str, first_stamp_ns: int) -> str:
    """The session (ULID) of a robot in a lockstep run: the same in every run."""
    digest = seed_of("session", scenario, agent_id).to_bytes(8, "big")
    return ulid(first_stamp_ns // 1_000_000, b"\x00\x00" + digest)


def play(
    scenario: Scenario,
    options: PlayOptions,
    stop: threading.Event,
    report: Report,
    on_rendering: OnRendering,
) -> dict[str, Any]:
    """Play all robots and wait until the server has everything.

    Args:
        scenario: Whom to play.
        options: How.
        stop: Ends the run early when set.
        report: Called now and then with the robots' progress, from the calling thread.
        on_rendering: Called while images are rendered, before anything is sent.

    Returns:
        The summary: ``agents.<id>.{session, keyframes, bytes, duration_s, rejected, ...}``, and
        ``staged_s``, how long it took until the first keyframe could be sent.

    Raises:
        NotDelivered: If not everything was acknowledged.
        RenderingStopped: If it was stopped before anything was sent.
        DatasetError, TrajectoryError, ConfigError: If a robot cannot be played.
    """
    began = time.monotonic()
    options.spool.mkdir(parents=True, exist_ok=True)
    parts = stage(scenario, options.results, stop, on_rendering)
    with ExitStack() as stack:
        robots = [_open(part, scenario, options, stack) for part in parts]
        staged_s = time.monotonic() - began
        patience = _Patience(robots, options.patience_s, stop)
        if options.lockstep:
            _play_in_lockstep(robots, patience, report)
        else:
            _play_together(robots, options.rate, patience, report)
        # Looked at once a round: what is pending shrinks while we look.
        while unfinished := [robot for robot in robots if robot.agent.pending]:
            patience.check()
            unfinished[0].agent.wait_delivered(_TICK_S)
            report(robots)
        report(robots)
        return _summary(scenario, options, robots, staged_s)


def _open(part: Part, scenario: Scenario, options: PlayOptions, stack: ExitStack) -> Robot:
    session = None
    if options.lockstep:
        session = lockstep_session(scenario.name, part.id, part.keyframes[0].stamp_ns)
    rejected: list[KeyframeId] = []

    def on_rejected(keyframe: KeyframeId, _: Rejected) -> None:
        rejected.append(keyframe)

    folder = options.credentials
    link = Agent(
        part.id,
        options.endpoint if folder is None else folder / f"{part.id}{SUFFIX}",
        options.spool / f"{part.id}.sqlite",
        validate(Config, scenario.config, f"config of scenario {scenario.name}"),
        session,
        on_rejected=on_rejected,
    )
    return Robot(part, stack.enter_context(link), rejected)


@dataclass(slots=True, eq=False)
class _Patience:
    """Notices that playing was stopped, or that the server has acknowledged nothing for long."""

    robots: Sequence[Robot]
    limit_s: float
    stop: threading.Event
    _acked: int = -1
    _since: float = field(default_factory=time.monotonic)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def check(self) -> None:
        """Raise NotDelivered if there is no point in going on."""
        waiting = sum(robot.agent.pending for robot in self.robots)
        if self.stop.is_set():
            raise NotDelivered(f"stopped with {waiting} keyframes not delivered")
        acked = sum(robot.acked for robot in self.robots)
        with self._lock:
            if acked != self._acked or waiting == 0:
                self._acked, self._since = acked, time.monotonic()
            silent_s = time.monotonic() - self._since
        if silent_s > self.limit_s:
            raise NotDelivered(
                f"the server acknowledged nothing for {silent_s:.0f} s; "
                f"{waiting} keyframes are not delivered"
            )


def _play_in_lockstep(robots: Sequence[Robot], patience: _Patience, report: Report) -> None:
    order = sorted(
        ((frame.stamp_ns, robot.id, robot, frame) for robot in robots for frame in robot.keyframes),
        key=lambda entry: entry[:2],
    )
    turns = [(robot, frame) for _, _, robot, frame in order]
    with ThreadPoolExecutor(1, "read-ahead") as pool:
        for robot, content in _contents(turns, pool):
            _send(robot, content)
            while not robot.agent.wait_delivered(_TICK_S):
                patience.check()
            patience.check()
            report(robots)


def _play_together(
    robots: Sequence[Robot], rate: float | None, patience: _Patience, report: Report
) -> None:
    begin = time.monotonic()
    with ThreadPoolExecutor(len(robots), "robot") as threads:
        playing = [threads.submit(_play_one, robot, rate, begin, patience) for robot in robots]
        pending: set[Future[None]] = set(playing)
        try:
            while pending:
                done, pending = wait(pending, _TICK_S, FIRST_EXCEPTION)
                report(robots)
                for ended in done:
                    ended.result()
        except BaseException:
            patience.stop.set()
            raise


def _play_one(robot: Robot, rate: float | None, begin: float, patience: _Patience) -> None:
    """Send one robot's keyframes when they are due and the server keeps up."""
    window = 2 * _READ_AHEAD
    first_ns = robot.keyframes[0].stamp_ns
    turns = [(robot, frame) for frame in robot.keyframes]
    with ThreadPoolExecutor(1, "read-ahead") as pool:
        for _, content in _contents(turns, pool):
            if rate is not None:
                due = begin + (content.stamp_ns - first_ns) * 1e-9 / rate
                patience.stop.wait(max(0.0, due - time.monotonic()))
            while rate is None and robot.agent.pending >= window:
                patience.check()
                robot.agent.wait_delivered(_TICK_S)
            if patience.stop.is_set():
                patience.check()
            _send(robot, content)


def _contents(
    turns: Sequence[tuple[Robot, Frame]], pool: ThreadPoolExecutor
) -> Iterator[tuple[Robot, KeyframeContent]]:
    """Keyframes in the order of turns, read ahead in the pool's thread."""
    under_way: deque[tuple[Robot, Future[KeyframeContent]]] = deque()
    try:
        for robot, frame in turns:
            under_way.append((robot, pool.submit(keyframe_content, robot.part, frame)))
            if len(under_way) > _READ_AHEAD:
                first, future = under_way.popleft()
                yield first, future.result()
        while under_way:
            first, future = under_way.popleft()
            yield first, future.result()
    finally:
        for _, future in under_way:
            future.cancel()


def keyframe_content(part: Part, frame: Frame) -> KeyframeContent:
    """What a robot measures in one of its frames; raises DatasetError as its source."""
    features, *more_features = part.source.all_features(frame)
    return KeyframeContent(
        frame.stamp_ns,
        frame.T_odom_body,
        part.source.camera,
        features,
        part.covariance.get(frame.number),
        frame.gravity_body,
        more_features=tuple(more_features),
    )


def _send(robot: Robot, content: KeyframeContent) -> None:
    name = robot.agent.send(content)
    sent = Keyframe(
        name,
        content.stamp_ns,
        content.T_odom_body,
        content.camera.hash,
        content.features,
        content.covariance,
        content.gravity_body,
        more_features=content.more_features,
    )
    robot.sent_bytes += len(codec.encode(sent))
    robot.sent += 1


def _summary(
    scenario: Scenario, options: PlayOptions, robots: Sequence[Robot], staged_s: float
) -> dict[str, Any]:
    agents = {}
    for robot in robots:
        frames = robot.part.source.frames
        agents[robot.id] = {
            "session": robot.agent.session,
            "keyframes": robot.sent,
            "bytes": robot.sent_bytes,
            "duration_s": (frames[-1].stamp_ns - frames[0].stamp_ns) / 1e9,
            "rejected": len(robot.rejected),
            "frames": len(frames),
            "images_without_pose": robot.part.source.skipped,
        }
    return {
        "scenario": scenario.name,
        "rate": options.rate,
        "lockstep": options.lockstep,
        "staged_s": round(staged_s, 3),
        "agents": agents,
    }
