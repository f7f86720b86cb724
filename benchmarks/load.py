"""Claim: fifty robots are served on two cores while solving is saturated, and workers scale.

- `uploads`: 50 robots send 4 keyframes/s of 40 kB each, over Zenoh, to a server that `covinz up`
  would start with two loop solvers, which have more jobs than they can do. Robots and server share
  the machine. An acknowledgement counts from when the keyframe was due; a correction from then
  until one comes that was computed with the keyframe.
- `dispatch`: eight worker processes against one, with a wait of 50 ms in place of solving, which
  measures the dispatcher beyond the number of cores; the jobs are there before.
- `solving`: two workers against one with real solving, from the first outcome to the last one;
  twelve robots play 40 keyframes each at the rate of their recordings, which is more than both
  workers can do from the first seconds on.
- `solving_at_once`: the same, but all robots send everything as fast as it is acknowledged.

The robots play recorded keyframes under other names (benchmarks/load.yaml). `others_cores` is what
programs that have nothing to do with it used of the processors meanwhile.

    python -m benchmarks.load [--parts PART ...] [--seconds S] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks import load_recordings, load_scaling, load_uploads
from benchmarks.fleet import gather
from covinz.scenario import load_scenario

_REPOSITORY = Path(__file__).resolve().parents[1]
_DATA = Path(os.environ.get("COVINZ_DATA", _REPOSITORY.parent / "shared" / "data"))
PARTS = ("uploads", "dispatch", "solving", "solving_at_once")


def measure(part: str, seconds: float, data: Path) -> dict[str, Any]:
    """One of `PARTS`, in a folder that is gone afterwards."""
    environ = os.environ | {"COVINZ_DATA": str(data)}
    fleet = gather(load_scenario(_REPOSITORY / "benchmarks" / "load.yaml", environ))
    with tempfile.TemporaryDirectory(prefix="covinz-load-") as name:
        recordings, folder = Path(name) / "recordings", Path(name) / part
        recordings.mkdir()
        folder.mkdir()
        load_recordings.write(recordings, fleet)
        if part == "uploads":
            made = load_uploads.measure(load_uploads.Fleet(seconds=seconds), recordings, folder)
            num_bytes = sum(fleet.num_bytes.values())
            return {"keyframe_bytes": round(num_bytes / len(fleet.keyframes)), **made}
        if part == "dispatch":
            return load_scaling.dispatch(recordings, folder)
        at_once = part == "solving_at_once"
        rate_hz = load_scaling.AT_ONCE_HZ if at_once else load_scaling.AS_RECORDED_HZ
        return load_scaling.solving(recordings, folder, rate_hz)


def report(parts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The parts that were measured, and the figures that matter on top."""
    names = ("keyframes_per_s", "ack_p50_ms", "ack_p99_ms", "keyframe_to_correction_p50_ms")
    headline = {name: parts["uploads"][name] for name in names if "uploads" in parts}
    if "dispatch" in parts:
        headline["dispatch_scaling_1_to_8"] = parts["dispatch"]["scaling"]
    for part in ("solving", "solving_at_once"):
        if part in parts:
            headline[f"{part}_scaling_1_to_2"] = parts[part]["scaling"]
    return {
        "benchmark": "load",
        "machine": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        **headline,
        **{part: parts[part] for part in PARTS if part in parts},
    }


def main() -> int:
    """Measure, print and write JSON; parts that are not measured again keep what the file has."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--seconds", type=float, default=60.0, help="how long robots send")
    parser.add_argument("--data", type=Path, default=_DATA, help="folder of the recordings")
    parser.add_argument("--json", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    parts: dict[str, Any] = {}
    text = ""
    if arguments.json and arguments.json.exists():
        before = json.loads(arguments.json.read_text())
        parts = {part: before[part] for part in PARTS if part in before}
    for part in arguments.parts:
        parts[part] = measure(part, arguments.seconds, arguments.data)
        sys.stderr.write(f"{part}: {json.dumps(parts[part])}\n")
        text = json.dumps(report(parts), indent=2) + "\n"
        if arguments.json:
            arguments.json.write_text(text)
    sys.stdout.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
