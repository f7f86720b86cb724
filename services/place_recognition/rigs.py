"""Loop jobs: the keyframes of the two rigs and what odometry knows of them, fixed when made.

Source: COVINS-G III-B2, S_q and S_c; decision 0021.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Final, Generic, TypeVar

from covinz.config import LoopSolverConfig, RigConfig
from covinz.types import Camera, KeyframeId, LoopJob, RigMember
from services.place_recognition.neighbours import choose, core_options
from services.place_recognition.track import Track

Members = tuple[RigMember, ...]
T = TypeVar("T")

# Keyframes whose rigs are remembered; a rig is about 2 kB.
MAX_REMEMBERED: Final = 4096


@dataclass(frozen=True, slots=True)
class Pair:
    """A query and one of its candidates; a job as soon as both rigs can be formed."""

    query: KeyframeId
    cand: KeyframeId
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Keyframes of one session.

    Attributes:
        members: The reference first, then the others.
        information: What they tell about scale, one over the relative variance; infinite where
            nobody asks for it.
    """

    members: Members
    information: float


class RigRule:
    """Forms the rigs of a pair from the keyframes logged so far, as configured.

    Args:
        rigs: Sizes, and how neighbours are chosen.
        solver: Its profile, and odometry's usual accuracy.
        camera: Gives a calibration by its hash; None for one that nobody has.
    """

    def __init__(
        self, rigs: RigConfig, solver: LoopSolverConfig, camera: Callable[[str], Camera | None]
    ) -> None:
        self._config = rigs
        self._options = core_options(rigs, solver.fast)
        self._camera = camera
        by_profile = "index" if solver.profile == "paper" else "geometry"
        self._by_geometry = (rigs.neighbours or by_profile) == "geometry"
        # What was found for a keyframe: the candidates of a query mostly share its rig, and a
        # keyframe is a candidate of several queries.
        self._chosen = _Memory[Rig | None]()
        self._complete = _Memory[Rig]()

    def query(self, pair: Pair, track: Track) -> Rig | None:
        """S_q, from the query's session; None while that has too few keyframes."""
        return self._rig(track, pair.query, pair.cand, self._config.query_size)

    def cand(self, pair: Pair, track: Track) -> Rig | None:
        """S_c, from the candidate's session; None while that has too few keyframes."""
        return self._rig(track, pair.cand, pair.query, self._config.cand_size)

    def _rig(self, track: Track, of: KeyframeId, other: KeyframeId, size: int) -> Rig | None:
        rig = None
        if self._by_geometry:
            rig = self._best(track, of, other, size)
        if rig is None:
            rig = nearest(track, of.seq, size)
        # Whatever size is asked for, a session that has the paper's number can close loops.
        if rig is None or len(rig.members) < min(size, 3):
            return None
        names = [member.keyframe for member in rig.members]
        which = (track, track.path.state(max(name.seq for name in names)), *names)
        return self._complete.get((of, size), which, partial(_with_odometry, track, rig))

    def _best(self, track: Track, of: KeyframeId, other: KeyframeId, size: int) -> Rig | None:
        """The best rig by geometry; None where a calibration is missing or unusable."""
        around = track.around(of.seq, self._config.max_steps)
        if of.segment == other.segment:
            # Half of the way to the other keyframe is that one's: rigs share no keyframe.
            around = tuple(
                m for m in around if abs(m.keyframe.seq - of.seq) < abs(m.keyframe.seq - other.seq)
            )
        # Keyframes are only ever added to a session, so this says which they are.
        which = (track, around[0].keyframe, around[-1].keyframe, len(around))
        return self._chosen.get((of, size), which, partial(self._choose, around, of, size))

    def _choose(self, around: Members, of: KeyframeId, size: int) -> Rig | None:
        cameras = [self._camera(member.camera_hash) for member in around]
        known = [camera for camera in cameras if camera is not None]
        if len(known) < len(around):
            return None
        T_odom_body = [member.T_odom_body for member in around]
        reference = [member.keyframe for member in around].index(of)
        try:
            choice = choose(T_odom_body, known, reference, size, self._options)
        except ValueError:
            return None
        return Rig(tuple(around[row] for row in choice.rows), choice.information)


def nearest(track: Track, seq: int, size: int) -> Rig | None:
    """The paper's rule: a keyframe and its nearest logged neighbours by index.

    A rig of two takes the predecessor, a larger one predecessors and successors by turns; where
    one side has too few the other gives more. None for a keyframe without any neighbour.
    """
    before, after = track.before(seq, size - 1), track.after(seq, size - 1)
    num_before = min(len(before), max(size // 2, size - 1 - len(after)))
    chosen = (*before[:num_before], *after[: size - 1 - num_before])
    return Rig((track.member(seq), *chosen), math.inf) if chosen else None


def _with_odometry(track: Track, rig: Rig) -> Rig:
    """The rig with what the session's odometry says of its members."""
    in_time = sorted(rig.members, key=lambda member: member.keyframe.seq)
    covariances = {
        later.keyframe: track.path.covariance(earlier.keyframe.seq, later.keyframe.seq)
        for earlier, later in pairwise(in_time)
    }
    members = tuple(
        RigMember(
            member.keyframe,
            member.T_odom_body,
            member.camera_hash,
            covariances.get(member.keyframe),
            track.path.twists(member.keyframe.seq),
        )
        for member in rig.members
    )
    return Rig(members, rig.information)


class _Memory(Generic[T]):
    """The value found last for each of the keyframes and sizes that came last."""

    def __init__(self) -> None:
        self._known: dict[tuple[KeyframeId, int], tuple[object, T]] = {}

    def get(self, name: tuple[KeyframeId, int], source: object, find: Callable[[], T]) -> T:
        """The value; found anew unless it is known from an equal source."""
        known = self._known.pop(name, None)
        if known is None or known[0] != source:
            known = (source, find())
        self._known[name] = known
        if len(self._known) > MAX_REMEMBERED:
            del self._known[next(iter(self._known))]
        return known[1]


def overlap(query: Sequence[RigMember], cand: Sequence[RigMember]) -> bool:
    """Whether a keyframe is in both rigs, so that matching it with itself would prove nothing."""
    return not {m.keyframe for m in query}.isdisjoint(m.keyframe for m in cand)


class JobMint:
    """Makes jobs whose identity says what was asked: pair, configuration, vocabulary."""

    def __init__(self, solver: LoopSolverConfig, rigs: RigConfig, vocabulary_hash: str) -> None:
        canonical = [
            json.dumps(config.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
            for config in (solver, rigs)
        ]
        self._context = "\n".join([*canonical, vocabulary_hash])

    def job(self, pair: Pair, query: Members, cand: Members) -> LoopJob:
        """The job of a pair whose rigs are known."""
        text = f"{pair.query}\n{pair.cand}\n{self._context}"
        digest = hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
        return LoopJob(digest, query, cand, pair.score)
