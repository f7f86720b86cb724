"""Claim: `Agent.send` never blocks for more than 50 ms, whatever hangs.

A robot sends keyframes of 1,000 ORB (38 kB) at 50 a second, ten times as many as robots do, with
router and ingest as real processes. `send_ms` is the time in `send`; `on_disk_share` for how many
sends the disk had all keyframes when `send` returned; `unsaved_max` how many it was behind at most;
`refused` how often `send` raised.

    python -m benchmarks.agent_send [--sends N] [--folder DIR] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from covinz import KeyframeContent, SpoolError, codec
from covinz.agent import Agent
from covinz.config import AgentConfig
from covinz.spool import Spool
from covinz.spool_rows import SpoolEntry
from covinz.types import KeyframeId
from covinz.ulid import new_ulid
from tests.processes import PATIENCE_S, Processes
from tests.uploads import CAMERA, content, keyframe, message

NUM_FEATURES = 1000
PERIOD_S = 0.02
BACKLOG = 10_000
# So many different keyframes are sent in turn.
VARIETY = 50
# What the busy disk is given to sync at once. [bytes]
HOG_BYTES = 32 * 1024 * 1024


def fill(file: Path, count: int) -> None:
    """Leave a backlog in a spool, as an earlier run without a server does."""
    session, camera = new_ulid(), codec.encode(CAMERA)
    made = keyframe(0, num_features=NUM_FEATURES)
    spool = Spool(file, "a0", AgentConfig())
    for first in range(0, count, 100):
        entries = []
        for seq in range(first, first + 100):
            name = KeyframeId("a0", session, seq)
            payload = codec.encode(replace(made, id=name))
            entries.append(SpoolEntry(name, 0, payload, CAMERA.hash, camera))
        spool.append(entries)
    spool.close()


def measure(agent: Agent, contents: list[KeyframeContent], count: int) -> dict[str, Any]:
    """Send at a steady rate; returns the figures."""
    times_s, refused, unsaved = [], 0, []
    begin = time.monotonic()
    pace = threading.Event()
    for number in range(count):
        pace.wait(max(0.0, begin + number * PERIOD_S - time.monotonic()))
        started = time.perf_counter()
        try:
            agent.send(contents[number % len(contents)])
        except SpoolError:
            refused += 1
        times_s.append(time.perf_counter() - started)
        unsaved.append(agent.unsaved)
    ms = 1e3 * np.array(times_s)
    p50, p99 = np.percentile(ms, [50, 99])
    return {
        "sends": count,
        "send_ms": {"p50": round(p50, 2), "p99": round(p99, 2), "max": round(ms.max(), 2)},
        "refused": refused,
        "on_disk_share": round(unsaved.count(0) / count, 3),
        "unsaved_max": max(unsaved),
        "pending_after": agent.pending,
    }


@contextmanager
def busy_disk(folder: Path) -> Iterator[None]:
    """Somebody else writes and syncs on the same disk without a pause."""
    stop = threading.Event()

    def write() -> None:
        with (folder / "hog").open("wb") as stream:
            while not stop.is_set():
                stream.seek(0)
                stream.write(os.urandom(HOG_BYTES))
                stream.flush()
                os.fsync(stream.fileno())

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def hung(server: Processes, name: str, stack: ExitStack) -> None:
    """Let a process hang until the end of the case."""
    server.freeze(name)
    stack.callback(server.thaw, name)


def gone(server: Processes, name: str, stack: ExitStack) -> None:
    """Let a process be dead until the end of the case."""
    server.kill(name)
    stack.callback(server.start, name)


Trouble = Callable[[Processes, Path, ExitStack], object]
# What is wrong while the robot sends, and how many keyframes wait in its spool before.
CASES: dict[str, tuple[Trouble, int]] = {
    "clean": (lambda server, folder, stack: None, 0),
    "router_hung": (lambda server, folder, stack: hung(server, "router", stack), 0),
    "ingest_hung": (lambda server, folder, stack: hung(server, "ingest", stack), 0),
    "link_gone": (lambda server, folder, stack: gone(server, "router", stack), 0),
    "backlog_link_gone": (lambda server, folder, stack: gone(server, "router", stack), BACKLOG),
    "backlog_draining": (lambda server, folder, stack: None, BACKLOG),
    "busy_disk": (lambda server, folder, stack: stack.enter_context(busy_disk(folder)), 0),
}


def run_case(server: Processes, folder: Path, name: str, count: int) -> dict[str, Any]:
    """One case with a spool of its own."""
    contents = [content(0, num_features=NUM_FEATURES) for _ in range(VARIETY)]
    trouble, backlog = CASES[name]
    spool = folder / f"{name}.sqlite"
    if backlog:
        fill(spool, backlog)
    with ExitStack() as stack:
        agent = Agent("a0", server.endpoint, spool)
        try:
            if not backlog:
                agent.send(contents[0])
                assert agent.wait_delivered(PATIENCE_S)
            trouble(server, folder, stack)
            figures = measure(agent, contents, count)
        finally:
            started = time.monotonic()
            agent.close()
            closed_s = time.monotonic() - started
    server.wait_ready("ingest")
    return {**figures, "close_s": round(closed_s, 2)}


def main() -> None:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sends", type=int, default=300, help="for each case")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--folder", type=Path, help="on the disk to measure [temporary]")
    parser.add_argument("--json", type=Path, help="file for the result, besides standard output")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name, Processes(Path(name)) as server:
        server.start("router", "ingest")
        cases = {
            case: run_case(server, Path(name), case, arguments.sends) for case in arguments.cases
        }
    made = {
        "benchmark": "agent_send",
        "machine": platform.machine(),
        "keyframe_bytes": len(message(0, num_features=NUM_FEATURES)),
        "period_s": PERIOD_S,
        "load_before": round(os.getloadavg()[0], 1),
        "send_ms_max": max(case["send_ms"]["max"] for case in cases.values()),
        "cases": cases,
    }
    text = json.dumps(made, indent=2)
    print(text)
    if arguments.json:
        arguments.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
