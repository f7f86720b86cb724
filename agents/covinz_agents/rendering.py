"""Renders the images of a scenario's robots before they are played, in a few processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from covinz.scenario import RenderedAgent, Scenario
from covinz.supervisor import die_with_parent
from covinz_agents.rendered import RenderedRobot
from covinz_agents.source import DatasetError, Frame, RenderingStopped
from covinz_agents.studio import studio

# So many processes, or as many as there are cores if that is less.
NUM_PROCESSES = 2
# Images that a process is given at a time.
_BATCH = 4
# How often a request to stop is looked at. [s]
_TICK_S = 0.1

OnProgress = Callable[[int, int], None]


@dataclass(slots=True, eq=False)
class _Painter:
    """A process that renders, and which robot it is at."""

    process: BaseProcess
    link: Connection
    robot: str | None = None
    batch: list[int] = field(default_factory=list)


def render_ahead(
    scenario: Scenario,
    robots: Mapping[str, tuple[RenderedRobot, Sequence[Frame]]],
    stop: threading.Event,
    on_progress: OnProgress,
) -> None:
    """Have all images in the cache that are not there yet.

    Args:
        scenario: Where the robots are.
        robots: By agent id, the robot and the frames to render.
        stop: Ends it early when set.
        on_progress: Called with images rendered and images to render, from this thread.

    Raises:
        RenderingStopped: If `stop` was set.
        DatasetError: If the world cannot be drawn, or the cache not written, on this machine.
    """
    todo = {
        name: [frame.number for frame in frames if not robot.is_rendered(frame)]
        for name, (robot, frames) in robots.items()
    }
    total = sum(map(len, todo.values()))
    if total == 0:
        return
    count = min(NUM_PROCESSES, os.cpu_count() or 1, -(-total // _BATCH))
    painters = [_start(scenario) for _ in range(count)]
    try:
        done = 0
        on_progress(done, total)
        while _employ_all(painters, todo):
            ready = wait([painter.link for painter in painters if painter.batch], _TICK_S)
            if stop.is_set():
                raise RenderingStopped(f"stopped after {done} of {total} images")
            for painter in painters:
                if painter.link in ready:
                    done += _finished(painter)
                    on_progress(done, total)
    finally:
        for painter in painters:
            painter.link.close()
            painter.process.terminate()
            painter.process.join()
        studio().prune()


def _start(scenario: Scenario) -> _Painter:
    # A fork would inherit the threads' locks and the bus; a fresh interpreter has nothing.
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_paint, args=(there, scenario), daemon=True)
    process.start()
    there.close()
    return _Painter(process, here)


def _employ_all(painters: Sequence[_Painter], todo: dict[str, list[int]]) -> bool:
    """Give every idle process work; False: none has any."""
    busy = [_employ(painter, todo) for painter in painters]
    return any(busy)


def _employ(painter: _Painter, todo: dict[str, list[int]]) -> bool:
    """Give an idle process work, of its own robot while there is any; False: nothing to do."""
    if painter.batch:
        return True
    if not todo.get(painter.robot or ""):
        # Setting up another robot's visit takes a while: begin with the longest.
        painter.robot = max(todo, key=lambda name: len(todo[name]))
    numbers = todo[painter.robot or ""]
    painter.batch, numbers[:] = numbers[:_BATCH], numbers[_BATCH:]
    if painter.batch:
        painter.link.send((painter.robot, painter.batch))
    return bool(painter.batch)


def _finished(painter: _Painter) -> int:
    """Number of images that a process has finished; raises what went wrong there."""
    try:
        error = painter.link.recv()
    except EOFError as gone:
        raise DatasetError("a process that rendered images died; memory may be short") from gone
    if error is not None:
        raise error
    count = len(painter.batch)
    painter.batch = []
    return count


def _paint(link: Connection, scenario: Scenario) -> None:
    """Main of a process: render what is asked for until nobody asks any more."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends us
    # The processes share the cores among themselves.
    os.environ["LP_NUM_THREADS"] = "1"
    agents = {a.id: a for a in scenario.agents if isinstance(a, RenderedAgent)}
    robots: dict[str, tuple[RenderedRobot, dict[int, Frame]]] = {}
    while True:
        try:
            name, numbers = link.recv()
        except EOFError:
            return
        try:
            if name not in robots:
                robot = RenderedRobot(agents[name], scenario)
                robots[name] = (robot, {frame.number: frame for frame in robot.frames})
            robot, frames = robots[name]
            for number in numbers:
                robot.image(frames[number])
        except Exception as error:
            link.send(error)
        else:
            link.send(None)
