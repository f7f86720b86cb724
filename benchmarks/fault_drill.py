"""Claim: any plug can be pulled: nothing is lost or doubled, and nobody has to help.

Every case plays the same scenario of two robots, with real processes, while something breaks:
processes are killed or hang, links lose packets or fail, disks are full. What the server has in the
end is compared with that of the undisturbed run.

    python -m benchmarks.fault_drill --json FILE [--case NAME ...]

With ``--case`` only these are played, and `clean`, and take their places in FILE. Cases that need
namespaces or mounts (root on Linux) are skipped without the right, and said to be.

Figures of a case:

- ``lost``: keyframes that `Agent.send` returned for, neither in the log nor in a declared gap.
- ``duplicated``: keyframes that are in the log more than once, jobs with one id, and loops between
  the same keyframes in the maps, counted beyond the first.
- ``loops_missing``, ``loops_extra``, ``loops_changed``: accepted loops that an undisturbed server
  has and this one has not; the reverse; and those whose pose differs in any bit. The undisturbed
  server is that of case ``clean``. Only where the loops are others than there, and the fault has
  changed the order of keyframes in the log or their session (``same_log`` is false), it is one that
  is given this case's own log (``replayed``).
- ``loops_unlike_clean``: loops that only one of this case and ``clean`` has, by robot and number of
  the keyframe, whatever the sessions.
- ``recovery_s``: from the end of the cause until all that waited at the robot then (``backlog``) is
  acknowledged and every process answers for itself; null where nothing has to recover. The cause
  ends with the signal for `kill -9` and for a hang, which is for ever; with fair weather for links.
- ``send_block_ms_max``: the longest call of `Agent.send`.
- ``human_needed``: 1 where the case did not come to its end by itself.
- ``failed``: why the case failed: any of the above is not zero, `recovery_s` is more than 5 s (15 s
  for hangs; 0.1 s more for every waiting keyframe after 30 % loss over TCP), or `send` took more
  than 50 ms.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from benchmarks.drill.cases import CLEAN, Case, cases
from benchmarks.drill.network import why_no_mounts, why_not
from benchmarks.drill.play import SCENARIO
from benchmarks.drill.recording import record
from benchmarks.drill.server import CHECKOUT
from covinz.scenario import load_scenario
from covinz.supervisor import child_environment, die_with_parent

# Sums of the report: name, and the figure of a case.
_SUMS = {
    "keyframes_lost_total": "lost",
    "duplicated_total": "duplicated",
    "human_needed": "human_needed",
}
# A case that takes longer than all its own limits together. [s]
_TIMEOUT_S = 600.0


def main() -> int:
    """Play the cases and write JSON; the exit code says whether one failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, required=True, help="file for the figures")
    parser.add_argument("--case", nargs="+", choices=cases(), help="play only these, and `clean`")
    parser.add_argument(
        "--keep", type=Path, help="new folder that keeps logs and data of the cases"
    )
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, _leave)
    chosen = [name for name in cases() if name in {CLEAN, *(arguments.case or cases())}]
    known = json.loads(arguments.json.read_text())["case"] if _adds(arguments) else {}
    with tempfile.TemporaryDirectory(prefix="covinz-drill-") as temporary:
        work = arguments.keep or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        record(load_scenario(SCENARIO), work)
        for name in chosen:
            case = cases()[name]
            known[name] = {"title": case.title, **play(name, case, work)}
            sys.stderr.write(f"{name}: {json.dumps(known[name])}\n")
            arguments.json.write_text(json.dumps(report(known), indent=2) + "\n")
    made = report(known)
    sys.stdout.write(json.dumps(made, indent=2) + "\n")
    return 1 if made["cases_failed"] else 0


def play(name: str, case: Case, work: Path) -> dict[str, Any]:
    """The figures of one case, played by a process of its own."""
    skipped = _why_skipped(case)
    if skipped is not None:
        return {"skipped": skipped}
    out = work / f"{name}.json"
    argv = [sys.executable, "-m", "benchmarks.drill.play", name]
    argv += ["--work", str(work), "--out", str(out)]
    with (work / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(
            argv,
            cwd=CHECKOUT,
            env=child_environment(),
            stdout=log,
            stderr=subprocess.STDOUT,
            preexec_fn=die_with_parent,
        )
        try:
            process.wait(_TIMEOUT_S)
        except BaseException as error:
            process.send_signal(signal.SIGTERM)
            process.wait()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
    if not out.exists():
        lines = (work / f"{name}.log").read_text(errors="replace").splitlines()
        why = lines[-1] if lines else f"ended with code {process.returncode}"
        return {"human_needed": 1, "failed": [f"the drill itself failed: {why}"]}
    figures: dict[str, Any] = json.loads(out.read_text())
    return figures


def report(played: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What is written: the sums, and every case in the order of `cases`."""
    real = [figures for figures in played.values() if "skipped" not in figures]
    sums = {name: sum(f.get(figure, 0) for f in real) for name, figure in _SUMS.items()}
    return {
        "benchmark": "fault_drill",
        "cpus": os.cpu_count(),
        "cases": len(real),
        "cases_failed": sum(bool(figures["failed"]) for figures in real),
        "cases_skipped": len(played) - len(real),
        "cases_not_played": len(cases()) - len(played),
        **sums,
        "case": {name: played[name] for name in cases() if name in played},
    }


def _adds(arguments: argparse.Namespace) -> bool:
    """Whether there are figures of other cases to keep."""
    file: Path = arguments.json
    return bool(arguments.case) and file.exists()


def _why_skipped(case: Case) -> str | None:
    reasons: Sequence[str | None] = (
        why_not() if case.transport is not None else None,
        why_no_mounts() if case.has_small_disk else None,
    )
    return next((reason for reason in reasons if reason is not None), None)


def _leave(number: int, _: FrameType | None) -> None:
    """Signal handler: leave through all `finally` blocks, once."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
