"""Claim: ...

    python -m benchmarks.load
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import load_recordings
from benchmarks.fleet import gather
from benchmarks.load_server import running_server
from covinz.scenario import load_scenario

_REPOSITORY = Path(__file__).resolve().parents[1]


def robots(server, recordings, first_end, start_s, rate, count, out, linger=0.0):
    argv = [sys.executable, "-m", "benchmarks.load_robots", "--endpoint", server.endpoint]
    argv += ["--recordings", str(recordings), "--robots", first_end, "--start", str(start_s)]
    argv += ["--rate", str(rate), "--count", str(count), "--out", str(out), "--linger", str(linger)]
    return subprocess.Popen(argv, cwd=_REPOSITORY)


def main():
    agents, rate, seconds, workers = 50, 4.0, float(sys.argv[1]), int(sys.argv[2])
    folder = Path(tempfile.mkdtemp(prefix="load"))
    rec = folder / "recordings"
    rec.mkdir()
    scenario = load_scenario(_REPOSITORY / "benchmarks" / "load.yaml", os.environ)
    fleet = gather(scenario)
    print(len(fleet.keyframes), {a: b for a, b in fleet.num_bytes.items()})
    load_recordings.write(rec, fleet)
    with running_server(folder / "server", workers) as server:
        start = time.monotonic() + 6
        players = [robots(server, rec, f"{a}:{a+25}", start, rate, int(rate * seconds), folder / f"out{a}.json", 2) for a in (0, 25)]
        time.sleep(max(0, start + 5 - time.monotonic()))
        u0 = server.usage(); t0 = time.monotonic()
        while players[0].poll() is None:
            time.sleep(5)
            s = server.status("place_recognition")
            print(round(time.monotonic() - t0), server.status("ingest").cursor, s.cursor, s.pending, flush=True)
            if t0 and time.monotonic() - t0 < seconds - 5:
                u1 = server.usage(); t1 = time.monotonic()
        for p in players: p.wait()
        for n in u1:
            print(n, round((u1[n].cpu_s - u0[n].cpu_s) / (t1 - t0), 3), round(u1[n].rss_mib), round(1e3*(u1[n].cpu_s - u0[n].cpu_s) / (t1 - t0)/200, 2))
        print(server.status("ingest").counters.get("retry_after"))
    out = [json.loads((folder / f"out{a}.json").read_text()) for a in (0, 25)]
    print([o["answers"] for o in out])
    lat = [1e3 * (a - d) for o in out for r in o["robots"] for d, a in zip(r["due_s"], r["acked_s"]) if a and d > start + 5]
    print("acked", len(lat), np.percentile(lat, [50, 90, 99, 100]))
    print("corr", sum(len(r["corrected"]) for o in out for r in o["robots"]))
    print(folder)

if __name__ == "__main__":
    main()
