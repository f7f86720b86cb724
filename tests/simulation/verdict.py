"""What must hold once the system is idle, however it came there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from covinz import client, codec, keyexprs
from covinz.bus import Bus
from covinz.config import Config
from covinz.types import (
    Camera,
    Correction,
    Gap,
    JobRecord,
    JobState,
    Keyframe,
    KeyframeId,
    LogEntry,
    LogPage,
    LogRange,
    LogView,
    LoopClosure,
    MapSnapshot,
    SegmentId,
)
from services.optimizer.maps import Maps
from services.optimizer.optimisation import optimise
from services.place_recognition.service import recognizer_factory
from tests.simulation import world
from tests.simulation.robot import Robot


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What the idle system answers.

    Attributes:
        full: The log with features.
        poses: The log as the optimizer reads it.
        jobs: All jobs.
        snapshots: All maps.
        known: What each robot knows: the segment that it is in, and its correction.
    """

    full: Sequence[LogEntry]
    poses: Sequence[LogEntry]
    jobs: Sequence[JobRecord]
    snapshots: Sequence[MapSnapshot]
    known: Sequence[tuple[SegmentId, Correction | None]]


def collect(bus: Bus, robots: Sequence[Robot]) -> Evidence:
    """Ask the server, as anybody may, and the robots."""
    return Evidence(
        _entries(bus, LogView.FULL),
        _entries(bus, LogView.POSE),
        list(client.jobs(bus)),
        client.snapshots(bus),
        [robot.knows() for robot in robots],
    )


def contents(evidence: Evidence) -> dict[str, int]:
    """How much there is of everything: a run of an empty system proves nothing."""
    states = Counter(record.state for record in evidence.jobs)
    summaries = [snapshot.summary for snapshot in evidence.snapshots]
    gaps = sum(isinstance(entry.item, Gap) for entry in evidence.full)
    return {
        "= keyframes": len(evidence.full) - gaps,
        "= gaps": gaps,
        "= jobs done": states[JobState.DONE],
        "= jobs given up": states[JobState.DEAD],
        "= loops": sum(summary.num_loops for summary in summaries),
        "= maps": len(summaries),
        "= maps of several segments": sum(len(summary.segments) > 1 for summary in summaries),
    }


def faults_of(
    evidence: Evidence,
    config: Config,
    robots: Sequence[Robot],
    losses: Mapping[str, int],
    poison: str,
    has_news: bool,
) -> list[str]:
    """Everything that does not hold.

    Args:
        evidence: What the system says.
        config: Its configuration.
        robots: What was sent, and what each robot knows.
        losses: For each job how often a worker was really lost with it in hand.
        poison: The job that kills whoever takes it; may be empty.
        has_news: Every robot had the occasion to ask for its latest correction.
    """
    found = _log_faults(evidence.full, robots)
    found += _job_faults(evidence, config, losses, poison)
    loops, allowed = _loops(evidence)
    found += _map_faults(evidence, config, loops, allowed)
    if has_news and not found:
        found += _correction_faults(evidence, config)
    return found


def _entries(bus: Bus, view: LogView) -> list[LogEntry]:
    entries: list[LogEntry] = []
    while True:
        (reply,) = bus.ask(keyexprs.LOG_RANGE, codec.encode(LogRange(len(entries), view)))
        page = codec.decode(reply, LogPage)
        entries += page.entries
        if len(entries) == page.head:
            return entries


def _log_faults(log: Sequence[LogEntry], robots: Sequence[Robot]) -> list[str]:
    """Each keyframe that `send` returned for is in the log once, or in a declared gap."""
    found: list[str] = []
    if [entry.log_index for entry in log] != list(range(len(log))):
        found.append("the log is not numbered without gaps")
    keyframes = [entry.item for entry in log if isinstance(entry.item, Keyframe)]
    gaps = [entry.item for entry in log if isinstance(entry.item, Gap)]
    times = Counter(kf.id for kf in keyframes)
    found += [f"{name} is in the log {count} times" for name, count in times.items() if count > 1]
    dropped = {
        KeyframeId(gap.agent, gap.session, seq)
        for gap in gaps
        for seq in range(gap.first_seq, gap.last_seq + 1)
    }
    sent = {name: pose for robot in robots for name, pose in robot.sent.items()}
    forgiven = {name for robot in robots for name in robot.forgiven}
    for name in sent:
        if not (name in times or name in dropped or name in forgiven):
            found.append(f"{name} was handed over and is not in the log")
    for kf in keyframes:
        if kf.id in sent and not np.allclose(sent[kf.id], kf.T_odom_body, atol=1e-9):
            found.append(f"{kf.id} is in the log with another pose")
    return found


def _job_faults(
    evidence: Evidence, config: Config, losses: Mapping[str, int], poison: str
) -> list[str]:
    """The jobs are those of a replay, in that order; each has its own outcome."""
    cameras: dict[str, Camera] = {world.CAMERA.hash: world.CAMERA}
    recognizer = recognizer_factory(config, cameras.get)()
    expected = [job for entry in evidence.full for job in recognizer.process(entry)]
    found = []
    if [job.id for job in expected] != [record.job.id for record in evidence.jobs]:
        found.append(
            f"{len(evidence.jobs)} jobs differ from the {len(expected)} of a replay of the log"
        )
    max_attempts = config.place_recognition.max_attempts
    for record in evidence.jobs:
        job = record.job
        if job.id == poison:
            if record.state is not JobState.DEAD or record.attempts < max_attempts:
                found.append(
                    f"the poison job is {record.state.value} after {record.attempts} attempts"
                )
        elif record.state is JobState.DEAD:
            if losses.get(job.id, 0) < max_attempts:
                found.append(
                    f"job {job.id} was given up, though only {losses.get(job.id, 0)} workers "
                    f"were lost with it"
                )
        elif record.state is not JobState.DONE or record.outcome is None:
            found.append(f"job {job.id} is {record.state.value} in an idle system")
        elif codec.encode(record.outcome) != _travelled(world.outcome(job)):
            found.append(f"job {job.id} has another outcome than its own")
    return found


def _travelled(outcome: object) -> bytes:
    """An outcome as the journal gives it: decoded and encoded once more than the solver's."""
    return codec.encode(codec.decode_outcome(codec.encode(outcome)))


def _loops(evidence: Evidence) -> tuple[dict[str, LoopClosure], dict[str, LoopClosure]]:
    """Loops that must be in the maps, and those of dead jobs, which may be."""
    must: dict[str, LoopClosure] = {}
    may: dict[str, LoopClosure] = {}
    for record in evidence.jobs:
        loop = world.outcome(record.job)
        if isinstance(loop, LoopClosure):
            decoded = codec.decode(codec.encode(loop), LoopClosure)
            (must if record.state is JobState.DONE else may)[loop.job_id] = decoded
    return must, may


def _map_faults(
    evidence: Evidence,
    config: Config,
    must: Mapping[str, LoopClosure],
    may: Mapping[str, LoopClosure],
) -> list[str]:
    """The maps are, bit by bit, those that a replay of log and loops gives."""
    loops = dict(must)
    num_shown = sum(snapshot.summary.num_loops for snapshot in evidence.snapshots)
    if num_shown != len(must):
        # A worker may have been lost between telling the optimizer and the dispatcher.
        loops |= may
    expected = replayed(evidence.poses, config, loops)
    if num_shown not in range(len(must), len(must) + len(may) + 1):
        return [f"the maps show {num_shown} loops, {len(must)} were accepted"]
    if num_shown not in (len(must), len(must) + len(may)):
        return []  # some dead jobs' loops: which ones is not told, so there is nothing to compare
    found = []
    names = [snapshot.summary.map_id for snapshot in evidence.snapshots]
    if names != [snapshot.summary.map_id for snapshot in expected]:
        return [f"the maps are {names}, of a replay {[s.summary.map_id for s in expected]}"]
    for have, want in zip(evidence.snapshots, expected, strict=True):
        for field in ("keyframes", "stamps_ns", "edge_from", "edge_to", "is_loop", "T_from_to"):
            if not np.array_equal(getattr(have, field), getattr(want, field)):
                found.append(f"map {have.summary.map_id}: {field} differ from a replay")
        if not np.array_equal(have.T_map_body, want.T_map_body):
            worst = np.abs(have.T_map_body - want.T_map_body).max()
            found.append(f"map {have.summary.map_id}: poses differ from a replay by {worst:g}")
    return found


def replayed(
    log: Sequence[LogEntry], config: Config, loops: Mapping[str, LoopClosure]
) -> list[MapSnapshot]:
    """The maps that log and loops stand for, as a client would get them (decision 0003)."""
    maps = settled(log, config, loops)
    snapshots = [maps.snapshot(summary.map_id) for summary in maps.map_list().maps]
    return [codec.decode(codec.encode(one), MapSnapshot) for one in snapshots if one is not None]


def settled(log: Sequence[LogEntry], config: Config, loops: Mapping[str, LoopClosure]) -> Maps:
    """Maps of a log and its loops with nothing left to optimise."""
    maps = Maps(config.optimizer)
    for entry in log:
        if isinstance(entry.item, Keyframe):
            maps.add_keyframe(entry.log_index, entry.item, 0)
    for job_id in sorted(loops):
        maps.add_loop(loops[job_id])
    for group in maps.stale(with_keyframes=True):
        maps.apply(optimise(maps.component(group), config.optimizer), 1)
    return maps


def _correction_faults(evidence: Evidence, config: Config) -> list[str]:
    """Every robot whose session is in the log knows where its odometry is in the map."""
    must, may = _loops(evidence)
    if may:
        return []
    maps = settled(evidence.poses, config, must)
    newest = set(maps.newest_segments())
    found = []
    for segment, correction in evidence.known:
        if segment not in newest:
            continue
        place = maps.placement(segment)
        assert place is not None
        if correction is None:
            found.append(f"{segment} has no correction")
        elif not np.allclose(correction.T_map_odom, place[1].T_map_odom, atol=1e-9):
            found.append(f"{segment} has an old correction")
    return found
