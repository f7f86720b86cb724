"""What a server has in the end, and what of it should not be so or is missing."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.drill.server import Server
from covinz import client, codec, keyexprs
from covinz.bus import Bus
from covinz.types import (
    Gap,
    Keyframe,
    KeyframeId,
    LogPage,
    LogRange,
    LogView,
    LoopClosure,
)

# Query, candidate.
Pair = tuple[str, str]
# Pairs by robot and number in the recording, whatever sessions they were sent in.
Places = frozenset[Pair]


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """What an idle server has.

    Attributes:
        keyframes: The log's, in its order.
        gaps: The log's.
        loops: The accepted ones; the relative pose to the last bit.
        doubles: Jobs with one id, and edges of a map between the same two keyframes, that are
            there more than once, counted beyond the first.
        maps: The agents of each map.
        counters: Of all processes, by instance.
    """

    keyframes: tuple[KeyframeId, ...]
    gaps: tuple[Gap, ...]
    loops: Mapping[Pair, bytes]
    doubles: int
    maps: tuple[tuple[str, ...], ...]
    counters: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class Verdict:
    """How an end differs from what it should be; all zero where it does not.

    Attributes:
        lost: Keyframes that `send` returned for and that are neither in the log nor in a gap.
        duplicated: Keyframes that are in the log more than once, and `End.doubles`.
        loops_missing: Loops that an undisturbed server accepts.
        loops_extra: Loops that it does not.
        loops_changed: Loops that it accepts with another pose.
    """

    lost: int
    duplicated: int
    loops_missing: int
    loops_extra: int
    loops_changed: int

    @property
    def loops_differ(self) -> bool:
        """Whether the accepted loops are not those of an undisturbed server, to the last bit."""
        return bool(self.loops_missing or self.loops_extra or self.loops_changed)


def look(bus: Bus, timeout_s: float) -> End:
    """Wait until a server has nothing left to do, and ask for what it has.

    Raises:
        TimeoutError: If it is at work for longer.
        ServerUnavailable: If a process stays away.
    """
    client.wait_idle(bus, timeout_s=timeout_s)
    items = list(_log(bus))
    jobs = list(client.jobs(bus))
    snapshots = client.snapshots(bus)
    loops = [job.outcome for job in jobs if isinstance(job.outcome, LoopClosure)]
    edges = [
        (snapshot.keyframes[i], snapshot.keyframes[j])
        for snapshot in snapshots
        for i, j, is_loop in zip(
            snapshot.edge_from, snapshot.edge_to, snapshot.is_loop, strict=True
        )
        if is_loop
    ]
    statuses = client.statuses(bus)
    return End(
        keyframes=tuple(item.id for item in items if isinstance(item, Keyframe)),
        gaps=tuple(item for item in items if isinstance(item, Gap)),
        loops={(str(loop.query), str(loop.cand)): loop.T_cand_query.tobytes() for loop in loops},
        doubles=repeated(job.job.id for job in jobs) + repeated(edges),
        maps=tuple(
            tuple(sorted({kf.agent for kf in snapshot.keyframes})) for snapshot in snapshots
        ),
        counters={status.instance: dict(status.counters) for status in statuses},
    )


def replay(data: Path, folder: Path, settings: Mapping[str, Any], timeout_s: float) -> End:
    """What an undisturbed server makes of the log in `data`, in an empty folder."""
    folder.mkdir(parents=True)
    for file in data.glob("ingest.sqlite*"):
        shutil.copy(file, folder / file.name)
    with Server(folder, folder, settings, workers=1) as server:
        return look(server.bus, timeout_s)


def judge(end: End, sent: Iterable[str], undisturbed: End) -> Verdict:
    """Compare what was sent and what an undisturbed server has with what there is."""
    logged = Counter(map(str, end.keyframes))
    declared = {
        str(KeyframeId(gap.agent, gap.session, seq))
        for gap in end.gaps
        for seq in range(gap.first_seq, gap.last_seq + 1)
    }
    return Verdict(
        lost=len(set(sent) - set(logged) - declared),
        duplicated=sum(logged.values()) - len(logged) + end.doubles,
        loops_missing=len(undisturbed.loops.keys() - end.loops.keys()),
        loops_extra=len(end.loops.keys() - undisturbed.loops.keys()),
        loops_changed=sum(
            end.loops[pair] != undisturbed.loops[pair]
            for pair in end.loops.keys() & undisturbed.loops.keys()
        ),
    )


def places(end: End, sent: Mapping[str, int]) -> Places:
    """The accepted loops by place; `sent` has the numbers of the keyframes."""

    def place(keyframe: str) -> str:
        return f"{keyframe.partition('/')[0]}/{sent.get(keyframe, keyframe)}"

    return frozenset((place(query), place(cand)) for query, cand in end.loops)


def repeated(things: Iterable[object]) -> int:
    """How many are there beyond the first of each."""
    counts = Counter(things)
    return sum(counts.values()) - len(counts)


def _log(bus: Bus) -> Iterable[Keyframe | Gap]:
    index, head = 0, 1
    while index < head:
        question = codec.encode(LogRange(index, LogView.POSE))
        replies = bus.ask(keyexprs.LOG_RANGE, question)
        if not replies:
            raise client.ServerUnavailable("ingest does not answer for its log")
        page = codec.decode(replies[0], LogPage)
        yield from (entry.item for entry in page.entries)
        index, head = index + len(page.entries), page.head
