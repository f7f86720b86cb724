"""When each robot was first joined to another: derived from the loops, in the order of the log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from covinz.pictures.subject import MapSubject


@dataclass(frozen=True, slots=True)
class Joining:
    """A segment's first link to another agent: the newest keyframe it had then, and to whom."""

    stamp_ns: int
    partner: str


def joinings(found: MapSubject) -> dict[int, Joining]:
    """For each track of a map, by its place in `found.tracks`, when it first met another agent.

    A loop can be found once both its keyframes are in the log. Loops are taken in that order; a
    segment has met another agent when a chain of loops leads to one. The stamp is that of the
    newest keyframe which the segment had in the log by then. Solving takes a while, so the
    optimizer knew a little later.
    """
    owner = {int(i): number for number, t in enumerate(found.tracks) for i in t.keyframes}
    group = {number: {number} for number in range(len(found.tracks))}
    met: dict[int, Joining] = {}
    in_log = np.maximum(found.loops.cand, found.loops.query)
    for edge in np.argsort(in_log, kind="stable"):
        a, b = owner[int(found.loops.cand[edge])], owner[int(found.loops.query[edge])]
        if group[a] is group[b]:
            continue
        for one, other in ((a, b), (b, a)):
            _meet(found, group[one], group[other], int(in_log[edge]), met)
        merged = group[a] | group[b]
        group.update(dict.fromkeys(merged, merged))
    return met


def _meet(
    found: MapSubject, ours: set[int], theirs: set[int], log_index: int, met: dict[int, Joining]
) -> None:
    """Note for all of `ours` that are still alone that they now know the agents of `theirs`."""
    for number in ours - met.keys():
        track = found.tracks[number]
        partners = sorted({found.tracks[n].agent for n in theirs} - {track.agent})
        if partners:
            newest = track.keyframes[track.keyframes <= log_index].argmax()
            met[number] = Joining(int(track.stamps_ns[newest]), partners[0])
