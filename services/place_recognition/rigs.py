"""Loop jobs: the five keyframes of the two rigs, fixed when the job is made.

Source: COVINS-G III-B2, S_q and S_c.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass

from covinz.config import LoopSolverConfig
from covinz.types import KeyframeId, LoopJob, RigMember
from services.place_recognition.track import Track

Rig = tuple[RigMember, ...]


@dataclass(frozen=True, slots=True)
class Pair:
    """A query and one of its candidates; a job as soon as both rigs can be formed."""

    query: KeyframeId
    cand: KeyframeId
    score: float


def query_rig(track: Track, seq: int) -> Rig | None:
    """S_q: the keyframe and its nearest logged predecessor, or successor when it has none.

    None when the session has no second keyframe yet.
    """
    neighbour = track.before(seq, 1) or track.after(seq, 1)
    return (track.member(seq), *neighbour) if neighbour else None


def cand_rig(track: Track, seq: int) -> Rig | None:
    """S_c: the keyframe with the nearest logged predecessor and successor.

    Where one of the two is missing the other side gives two. None when the session has less
    than three keyframes yet.
    """
    before, after = track.before(seq, 2), track.after(seq, 2)
    neighbours = (before[0], after[0]) if before and after else before + after
    return (track.member(seq), *neighbours) if len(neighbours) == 2 else None


def overlap(query: Rig, cand: Rig) -> bool:
    """Whether a keyframe is in both rigs, so that matching it with itself would prove nothing."""
    return not {m.keyframe for m in query}.isdisjoint(m.keyframe for m in cand)


class JobMint:
    """Makes jobs whose identity says what was asked: pair, solver configuration, vocabulary."""

    def __init__(self, solver: LoopSolverConfig, vocabulary_hash: str) -> None:
        canonical = json.dumps(
            solver.model_dump(mode="json"), sort_keys=True, separators=(",", ":")
        )
        self._context = f"{canonical}\n{vocabulary_hash}"

    def job(self, pair: Pair, query: Rig, cand: Rig) -> LoopJob:
        """The job of a pair whose rigs are known."""
        text = f"{pair.query}\n{pair.cand}\n{self._context}"
        digest = hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
        return LoopJob(digest, query, cand, pair.score)
