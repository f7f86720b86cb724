"""How many jobs a second more workers do: with a wait in place of solving, and really solving."""

from __future__ import annotations

import shutil
import statistics
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.load_server import Server, running_server
from benchmarks.load_uploads import Fleet, play
from benchmarks.load_worker import WAIT_S

# Keyframes of each robot a second: as recorded, and as fast as they are acknowledged.
AS_RECORDED_HZ = 4.0
AT_ONCE_HZ = 1e6
# Robots are up and connected within this time, and begin then. [s]
_READY_S = 3.0


def dispatch(recordings: Path, folder: Path, counts: Sequence[int] = (1, 8)) -> dict[str, Any]:
    """Jobs a second of workers that wait 50 ms with every job.

    The log and its jobs are there before, so that nothing but dispatching goes on.
    """
    log = folder / "log"
    with running_server(log, workers=0) as server:
        upload(server, recordings, AT_ONCE_HZ, robots=12, each=60, out=folder / "uploads.json")
        server.wait_looked_up()
        jobs = server.status("place_recognition").pending
    rates = {}
    for count in counts:
        copy = folder / f"{count}"
        shutil.copytree(log / "data", copy / "data")
        with running_server(copy, workers=0, waiting=count) as server:
            server.wait_looked_up()
            rates[count] = _rate(server)
    first, last = counts[0], counts[-1]
    return {
        "wait_ms": 1e3 * WAIT_S,
        "jobs": jobs,
        "jobs_per_s": {str(count): round(rate, 2) for count, rate in rates.items()},
        "scaling": round(rates[last] / rates[first], 2),
    }


def solving(
    recordings: Path, folder: Path, rate_hz: float, counts: Sequence[int] = (1, 2), rounds: int = 5
) -> dict[str, Any]:
    """Jobs a second from about the first outcome to the last one, all processes at work.

    Before, there is nothing to solve: robots have only begun. In turn, so that what else the
    machine does meets all of them; medians.

    Args:
        recordings: What robots play.
        folder: For the servers' data.
        rate_hz: Keyframes of each robot a second.
        counts: Workers.
        rounds: Measurements with each count.
    """
    rates: dict[int, list[float]] = {count: [] for count in counts}
    jobs = []
    for number in range(rounds):
        for count in counts:
            with running_server(folder / f"{number}-{count}", workers=count) as server:
                out = folder / "uploads.json"
                player = begin_upload(server, recordings, rate_hz, robots=12, each=40, out=out)
                server.wait(lambda: server.jobs_done() > 0, "the first outcome")
                before, began_s = server.jobs_done(), time.monotonic()
                finish(player)
                server.wait_looked_up(jobs_done=True)
                jobs.append(server.jobs_done())
                rates[count].append((jobs[-1] - before) / (time.monotonic() - began_s))
    first, last = (statistics.median(rates[count]) for count in (counts[0], counts[-1]))
    return {
        "rate_hz": rate_hz if rate_hz < AT_ONCE_HZ else None,
        "jobs": round(statistics.median(jobs)),
        "rounds": rounds,
        "jobs_per_s": {str(count): round(statistics.median(rates[count]), 2) for count in counts},
        "scaling": round(last / first, 2),
    }


def upload(
    server: Server, recordings: Path, rate_hz: float, robots: int, each: int, out: Path
) -> None:
    """Let robots send all they have, at this rate or as fast as the server takes it."""
    finish(begin_upload(server, recordings, rate_hz, robots, each, out))


def begin_upload(
    server: Server, recordings: Path, rate_hz: float, robots: int, each: int, out: Path
) -> subprocess.Popen[bytes]:
    """Start robots that send all they have; `finish` waits for them."""
    fleet = Fleet(robots, rate_hz, each / rate_hz, linger_s=0.0)
    start_s = time.monotonic() + _READY_S
    return play(server, recordings, (0, robots), start_s, fleet, out)


def finish(player: subprocess.Popen[bytes]) -> None:
    """Wait for robots; RuntimeError where they failed."""
    if player.wait():
        raise RuntimeError(f"robots ended with {player.returncode}")


def _rate(server: Server, seconds: float = 8.0) -> float:
    """Outcomes a second, once all workers have had some jobs."""
    time.sleep(1.0)
    before, began_s = server.jobs_done(), time.monotonic()
    time.sleep(seconds)
    after, ended_s = server.jobs_done(), time.monotonic()
    if not server.status("place_recognition").pending:
        raise RuntimeError("the jobs ran out: there is nothing to measure")
    return (after - before) / (ended_s - began_s)
