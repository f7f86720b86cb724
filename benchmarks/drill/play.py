"""Plays one case in a process of its own, which enters the case's namespaces, and judges it.

    python -m benchmarks.drill.play CASE --work DIR --out FILE

The first robot plays in lockstep. The second streams in real time, and on its way the case's fault
is made. When all has arrived and the server is idle, what it has is compared with the undisturbed
run in `DIR/undisturbed`, which the first case leaves. Where its loops are others, and so is order
or a session in the log, the comparison is with an undisturbed server given this very log.
"""

from __future__ import annotations

import argparse
import json
import pickle
import signal
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from benchmarks.drill.cases import STREAMING, WORKERS, Case, cases
from benchmarks.drill.fleet import RobotFailed
from benchmarks.drill.link import SERVER_HOST
from benchmarks.drill.network import Network, own_mounts
from benchmarks.drill.server import Server
from benchmarks.drill.stage import PATIENCE_S, Stage, mount_small_disk
from benchmarks.drill.verdict import End, Places, Verdict, judge, look, places, replay
from covinz.client import ServerUnavailable
from covinz.scenario import Scenario, load_scenario

FIRST = "agent0"
UNDISTURBED = "undisturbed"
SCENARIO = Path(__file__).with_name("scenario.yaml")
# `Agent.send` never takes longer. [ms]
MAX_BLOCK_MS = 50.0
_SEED = 1
_IDLE_S = 120.0


def main() -> None:
    """Play, judge, write the figures."""
    signal.signal(signal.SIGTERM, _leave)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("case", choices=cases())
    parser.add_argument("--work", type=Path, required=True, help="folder of the drill")
    parser.add_argument("--out", type=Path, required=True, help="file for the figures")
    arguments = parser.parse_args()
    case = cases()[arguments.case]
    folder = arguments.work / arguments.case
    folder.mkdir()
    began = time.monotonic()
    try:
        figures = play(case, arguments.work, folder)
    except (RobotFailed, ServerUnavailable, TimeoutError, RuntimeError) as error:
        traceback.print_exc()
        figures = {"human_needed": 1, "failed": [f"stuck: {error}"]}
    figures["wall_s"] = round(time.monotonic() - began, 1)
    arguments.out.write_text(json.dumps(figures))


def play(case: Case, work: Path, folder: Path) -> dict[str, Any]:
    """The figures of a case.

    Raises:
        RobotFailed, ServerUnavailable, TimeoutError: If it does not get to its end by itself.
    """
    scenario = load_scenario(SCENARIO)
    with _stage(case, scenario, work, folder) as stage:
        first = stage.start_robot(FIRST)
        first.wait_done(PATIENCE_S)
        first.close()
        if case.twofold:
            stage.add_twofold_worker()
        streaming = ("--rate", str(case.rate), *case.options)
        stage.start_robot(STREAMING, *streaming, module=case.robot)
        stage.robot.wait_sent(case.before, PATIENCE_S)
        recovery = _recover(stage, case.fault(stage), case)
        stage.robot.wait_done(PATIENCE_S)
        end = look(stage.server.bus, _IDLE_S)
        starts = stage.server.starts()
        sent = {name: number for robot in stage.robots for name, number in robot.sent.items()}
        block_ms = [ms for robot in stage.robots for ms in robot.block_ms]
        refused = sum(robot.refused for robot in stage.robots)
        clean, clean_places = _clean(end, places(end, sent), work)
        undisturbed = clean
        same_log = clean.keyframes == end.keyframes and not end.gaps
        if not same_log and judge(end, sent, clean).loops_differ:
            undisturbed = replay(stage.data, folder / "replay", scenario.config, _IDLE_S)
    verdict = judge(end, sent, undisturbed)
    return {
        "lost": verdict.lost,
        "duplicated": verdict.duplicated,
        "loops": len(end.loops),
        "loops_missing": verdict.loops_missing,
        "loops_extra": verdict.loops_extra,
        "loops_changed": verdict.loops_changed,
        "same_log": same_log,
        "replayed": undisturbed is not clean,
        "loops_unlike_clean": len(places(end, sent) ^ clean_places),
        **recovery,
        "send_block_ms_max": round(max(block_ms), 1),
        "sends_over_50_ms": sum(ms > MAX_BLOCK_MS for ms in block_ms),
        "refused": refused,
        "gaps": len(end.gaps),
        "maps": len(end.maps),
        "processes_restarted": starts - 4 - len(WORKERS),
        "duplicate_uploads": _counted(end, "ingest", "duplicates"),
        "duplicate_outcomes": _counted(end, "place_recognition", "duplicate_outcomes"),
        "human_needed": 0,
        "failed": _failed(case, verdict, recovery, max(block_ms)),
    }


@contextmanager
def _stage(case: Case, scenario: Scenario, work: Path, folder: Path) -> Iterator[Stage]:
    with ExitStack() as stack:
        network = None
        if case.transport is not None:
            network = stack.enter_context(Network(_SEED))
            network.enter()
        spools, data = folder / "spools", folder / "data"
        if case.has_small_disk:
            own_mounts()
        for place, megabytes in ((spools, case.robot_disk_mb), (data, case.server_disk_mb)):
            if megabytes is None:
                place.mkdir()
            else:
                mount_small_disk(place, megabytes)
        host = SERVER_HOST if network else None
        server = Server(folder, data, scenario.config, len(WORKERS), host, case.transport or "tls")
        server.enrol((FIRST, STREAMING))
        stack.enter_context(server)
        stage = Stage(folder, work, spools, data, server, network)
        stack.callback(stage.close)
        yield stage


def _recover(stage: Stage, ended: float, case: Case) -> dict[str, Any]:
    """How long it takes until what waits now is acknowledged and every process answers."""
    handed_over, backlog = stage.robot.waiting()
    if case.recovery_s is None:
        return {"recovery_s": None, "backlog": backlog}
    ready = stage.server.wait_ready(time.monotonic() + PATIENCE_S)
    if ready is None:
        raise TimeoutError("not every process of the server answers")
    acked = stage.robot.when_acked(handed_over, PATIENCE_S)
    # When it was acknowledged before the cause ended, only the processes count.
    return {
        "recovery_s": round(max(ready, acked, ended) - ended, 2),
        "ready_s": round(max(ready - ended, 0.0), 2),
        "drained_s": round(max(acked - ended, 0.0), 2),
        "backlog": backlog,
    }


def _clean(end: End, loops: Places, work: Path) -> tuple[End, Places]:
    """The end of the undisturbed run, which is the first that is played."""
    file = work / UNDISTURBED
    if not file.exists():
        file.write_bytes(pickle.dumps((end, loops)))
    known: tuple[End, Places] = pickle.loads(file.read_bytes())
    return known


def _failed(
    case: Case, verdict: Verdict, recovery: dict[str, Any], block_ms: float
) -> Sequence[str]:
    counts = {
        "lost": verdict.lost,
        "duplicated": verdict.duplicated,
        "loops missing": verdict.loops_missing,
        "loops extra": verdict.loops_extra,
        "loops changed": verdict.loops_changed,
    }
    failed = [f"{count} {what}" for what, count in counts.items() if count]
    if case.recovery_s is not None:
        bar_s = case.recovery_s + case.drain_s * recovery["backlog"]
        if recovery["recovery_s"] > bar_s:
            failed.append(f"recovered after {recovery['recovery_s']} s, not {bar_s:.1f} s")
    if block_ms > MAX_BLOCK_MS:
        failed.append(f"send took {block_ms:.0f} ms")
    return failed


def _counted(end: End, instance: str, counter: str) -> int:
    return int(end.counters.get(instance, {}).get(counter, 0))


def _leave(number: int, _: FrameType | None) -> None:
    """Signal handler: leave through all `finally` blocks, once."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)


if __name__ == "__main__":
    main()
