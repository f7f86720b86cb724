"""Fifty robots at four keyframes a second while loop solvers have more to do than they can."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.load_server import Server, Usage, machine_cpu_s, process_usage, running_server

_REPOSITORY = Path(__file__).resolve().parents[1]
# Between two looks at the server. [s]
_LOOK_S = 1.0


@dataclass(frozen=True, slots=True)
class Fleet:
    """How many robots, how fast, and how long.

    Attributes:
        robots: How many.
        rate_hz: Keyframes of each a second.
        seconds: How long they send.
        players: Processes that play them.
        workers: Loop solvers.
        connect_s: Time for the robots to connect before that.
        warm_up_s: How much of `seconds` is over before measuring begins.
        linger_s: How much longer than they send they listen for corrections.
    """

    robots: int = 50
    rate_hz: float = 4.0
    seconds: float = 60.0
    players: int = 2
    workers: int = 2
    connect_s: float = 6.0
    warm_up_s: float = 10.0
    linger_s: float = 5.0


def measure(fleet: Fleet, recordings: Path, folder: Path) -> dict[str, Any]:
    """All figures of the uploads; the folder is empty before."""
    with running_server(folder / "server", fleet.workers) as server:
        start_s = time.monotonic() + fleet.connect_s
        bounds = np.linspace(0, fleet.robots, fleet.players + 1).astype(int)
        players = [
            play(server, recordings, (first, end), start_s, fleet, folder / f"{first}.json")
            for first, end in itertools.pairwise(map(int, bounds))
        ]
        load = _watch(server, [player.pid for player in players], start_s, fleet)
        for player in players:
            if player.wait():
                raise RuntimeError(f"robots ended with {player.returncode}")
        head = server.status("ingest").cursor
    played = [json.loads((folder / f"{first}.json").read_text()) for first in bounds[:-1]]
    sent_per_s = fleet.robots * fleet.rate_hz
    return {
        "robots": fleet.robots,
        "rate_hz": fleet.rate_hz,
        "workers": fleet.workers,
        "seconds": fleet.seconds,
        **upload_figures(played, start_s + fleet.warm_up_s, start_s + fleet.seconds),
        "in_log": head,
        **load,
        "cpu_ms_per_keyframe": {
            name: round(1e3 * cores / sent_per_s, 3) for name, cores in load["cores"].items()
        },
    }


def play(
    server: Server, recordings: Path, robots: tuple[int, int], start_s: float, fleet: Fleet,
    out: Path,
) -> subprocess.Popen[bytes]:  # fmt: skip
    """Robots number `robots[0]` up to `robots[1]` in a process that begins to connect now."""
    count = round(fleet.rate_hz * fleet.seconds)
    options = {
        "endpoint": server.endpoint,
        "recordings": recordings,
        "robots": f"{robots[0]}:{robots[1]}",
        "start": start_s,
        "rate": fleet.rate_hz,
        "count": count,
        "linger": fleet.linger_s,
        "out": out,
    }
    argv = [sys.executable, "-m", "benchmarks.load_robots"]
    argv += [word for name, value in options.items() for word in (f"--{name}", str(value))]
    return subprocess.Popen(argv, cwd=_REPOSITORY)


def _watch(server: Server, players: Sequence[int], start_s: float, fleet: Fleet) -> dict[str, Any]:
    """What the processes use from the end of the warm-up to the end of sending."""
    time.sleep(max(0.0, start_s + fleet.warm_up_s - time.monotonic()))
    began_s, before = time.monotonic(), _usage(server, players)
    machine_s, first = machine_cpu_s(), server.status("place_recognition")
    looks = [first]
    while time.monotonic() + _LOOK_S < start_s + fleet.seconds:
        time.sleep(_LOOK_S)
        looks.append(server.status("place_recognition"))
    lasted_s, after = time.monotonic() - began_s, _usage(server, players)
    machine_s = machine_cpu_s() - machine_s
    cores = {name: (after[name].cpu_s - before[name].cpu_s) / lasted_s for name in after}
    return {
        "cores": {name: round(used, 3) for name, used in cores.items()},
        "others_cores": round(machine_s / lasted_s - sum(cores.values()), 3),
        "rss_mib": {name: round(usage.rss_mib, 1) for name, usage in after.items()},
        "solving_saturated": round(float(np.mean([look.pending > 0 for look in looks])), 3),
        "looked_up_per_s": round((looks[-1].cursor - first.cursor) / lasted_s, 1),
        "jobs_pending": looks[-1].pending,
    }


def _usage(server: Server, players: Sequence[int]) -> dict[str, Usage]:
    """Of the server's processes, and of all players together."""
    playing = [process_usage(pid) for pid in players]
    together = Usage(sum(u.cpu_s for u in playing), sum(u.rss_mib for u in playing))
    return {**server.usage(), "robots": together}


def upload_figures(
    played: Sequence[Mapping[str, Any]], begin_s: float, end_s: float
) -> dict[str, Any]:
    """Acknowledgements and corrections of the keyframes that were due within [begin_s, end_s)."""
    answers: Counter[str] = Counter()
    acks_ms, corrections_ms, num_due, num_acked_within = [], [], 0, 0
    for player in played:
        answers.update(player["answers"])
        for robot in player["robots"]:
            corrected = _first_corrections(robot["corrected"], len(robot["due_s"]))
            times = zip(robot["due_s"], robot["acked_s"], corrected, strict=True)
            for due_s, acked_s, corrected_s in times:
                num_acked_within += acked_s is not None and begin_s <= acked_s < end_s
                if not begin_s <= due_s < end_s:
                    continue
                num_due += 1
                acks_ms += [] if acked_s is None else [1e3 * (acked_s - due_s)]
                corrections_ms += [] if corrected_s is None else [1e3 * (corrected_s - due_s)]
    return {
        "answers": dict(sorted(answers.items())),
        "keyframes_due": num_due,
        "keyframes_accepted": len(acks_ms),
        "keyframes_per_s": round(num_acked_within / (end_s - begin_s), 1),
        **_spread("ack", acks_ms),
        "keyframes_corrected": len(corrections_ms),
        **_spread("keyframe_to_correction", corrections_ms),
    }


def _first_corrections(
    corrected: Sequence[tuple[float, int]], count: int
) -> Sequence[float | None]:
    """When each keyframe was first in what a correction was computed from: it names the newest."""
    first: list[float | None] = [None] * count
    known = 0
    for at_s, seq in corrected:
        for earlier in range(known, min(seq + 1, count)):
            first[earlier] = at_s
        known = max(known, seq + 1)
    return first


def _spread(name: str, values_ms: Sequence[float]) -> dict[str, float | None]:
    shares = {"p50": 50, "p99": 99, "max": 100}
    return {
        f"{name}_{label}_ms": round(float(np.percentile(values_ms, q)), 1) if values_ms else None
        for label, q in shares.items()
    }
