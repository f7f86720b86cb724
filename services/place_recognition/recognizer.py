"""From the keyframe log to loop jobs: look up, guard, rank, form the rigs, then index.

Source: COVINS-G III-A; docs/architecture.md.
"""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from collections.abc import Callable

from covinz.config import LoopSolverConfig, PlaceRecognitionConfig
from covinz.logs import about
from covinz.types import (
    Camera,
    Keyframe,
    KeyframeId,
    LogEntry,
    LoopJob,
    SegmentId,
)
from services.place_recognition import guards, rigs
from services.place_recognition.places import Descriptions, Places
from services.place_recognition.rigs import JobMint, Pair, Rig, RigRule
from services.place_recognition.track import PastQuery, QueryHistory, Track

logger = logging.getLogger(__name__)

# Keyframes of its session that a pair waits for, if its rigs do not tell the scale.
PATIENCE = 2


class Recognizer:
    """Turns log entries, in order, into jobs; the jobs are a function of the log alone.

    Keyframes that have no kind of feature that is in use, or too few of it to pass verification,
    take no part: not as query, nor as candidate, nor as neighbour in a rig.

    Attributes:
        counters: What happened so far, by name.
    """

    def __init__(
        self,
        config: PlaceRecognitionConfig,
        solver: LoopSolverConfig,
        places: Places,
        camera: Callable[[str], Camera | None],
    ) -> None:
        self._config = config
        self._places = places
        self._mint = JobMint(solver, config.rigs, places.identity)
        self._rule = RigRule(config.rigs, solver, camera)
        self._noise = solver.fast.odometry
        self._tracks: dict[SegmentId, Track] = {}
        self._tracks_of: defaultdict[str, list[Track]] = defaultdict(list)
        self._history: defaultdict[SegmentId, QueryHistory] = defaultdict(QueryHistory)
        # Sessions whose agent has begun another one.
        self._over: set[SegmentId] = set()
        self._indexed: list[KeyframeId] = []
        self._waiting: defaultdict[SegmentId, list[Pair]] = defaultdict(list)
        self.counters: Counter[str] = Counter()

    @property
    def waiting(self) -> int:
        """Pairs that become jobs when their sessions have the keyframes that the rigs need."""
        return sum(len(pairs) for pairs in self._waiting.values())

    def process(self, entry: LogEntry) -> list[LoopJob]:
        """The jobs that come to be with this entry; entries must come in log order."""
        kf = entry.item
        if not isinstance(kf, Keyframe):
            return []
        jobs = self._begin(kf.id.segment)
        track = self._tracks[kf.id.segment]
        track.path.insert(kf.id.seq, kf.stamp_ns, kf.T_odom_body, kf.covariance)
        descriptions = self._describe(kf)
        if descriptions:
            track.insert(kf)
        # Pairs that waited for this session are older than those the keyframe brings.
        jobs += self._form(self._waiting.pop(kf.id.segment, []))
        if descriptions:
            jobs += self._form(self._query(kf.id, descriptions))
            self._add(kf.id, descriptions)
        return jobs

    def _describe(self, kf: Keyframe) -> Descriptions:
        if kf.features is None:  # they were dropped from the log
            self.counters["skipped.features_expired"] += 1
            return {}
        descriptions = self._places.describe(kf)
        counts = {block.type.name.lower(): len(block) for block in kf.all_features}
        if not descriptions and counts and not counts.keys() & set(self._places.kinds):
            self._skip(kf, "skipped.feature_type", f"only has {', '.join(counts)}")
        elif not descriptions:
            self._skip(kf, "skipped.few_features", f"features: {counts}")
        return descriptions

    def _skip(self, kf: Keyframe, counter: str, reason: str) -> None:
        self.counters[counter] += 1
        logger.info(
            "keyframe %s takes no part in place recognition: %s",
            kf.id,
            reason,
            extra=about(keyframe=kf.id),
        )

    def _begin(self, segment: SegmentId) -> list[LoopJob]:
        """Note a session; one that is new ends the others of its agent, and what waits for them."""
        if segment in self._tracks:
            return []
        jobs = []
        for track in self._tracks_of[segment.agent]:
            self._over.add(track.segment)
            jobs += self._form(self._waiting.pop(track.segment, []))
        self._tracks[segment] = Track(segment, self._noise)
        self._tracks_of[segment.agent].append(self._tracks[segment])
        return jobs

    def _query(self, query: KeyframeId, descriptions: Descriptions) -> list[Pair]:
        track, history = self._tracks[query.segment], self._history[query.segment]
        if not guards.may_query(query.seq, track, history, self._config):
            self.counters["not_queried"] += 1
            return []
        mask = guards.eligible(query, len(self._places), self._tracks_of[query.agent], self._config)
        found = [
            Pair(query, self._indexed[slot], score)
            for slot, score in self._places.best(descriptions, mask)
        ]
        pairs = found
        if self._config.consistent_queries:
            pairs = [
                pair
                for pair in found
                if guards.consistent(pair.cand, query.seq, history, self._config)
            ]
        past = PastQuery(query.seq, tuple(pair.cand for pair in found))
        history.add(past, productive=bool(pairs))
        self.counters["queries"] += 1
        return pairs

    def _form(self, pairs: list[Pair]) -> list[LoopJob]:
        """Make jobs of the pairs whose rigs can be formed; the others wait for their session."""
        jobs = []
        for pair in pairs:
            query = self._rule.query(pair, self._tracks[pair.query.segment])
            cand = self._rule.cand(pair, self._tracks[pair.cand.segment])
            if query is None:
                self._waiting[pair.query.segment].append(pair)
            elif cand is None:
                self._waiting[pair.cand.segment].append(pair)
            elif (awaited := self._awaited(pair, query, cand)) is not None:
                self._waiting[awaited].append(pair)
            elif rigs.overlap(query.members, cand.members):
                self.counters["skipped.overlap"] += 1
            else:
                jobs.append(self._mint.job(pair, query.members, cand.members))
        self.counters["candidates"] += len(jobs)
        return jobs

    def _awaited(self, pair: Pair, query: Rig, cand: Rig) -> SegmentId | None:
        """The session whose next keyframes may tell the scale that the rigs do not, if any.

        A session is waited for until it has gone on by `PATIENCE` keyframes, or is over.
        """
        if query.information + cand.information >= self._config.rigs.min_information:
            return None
        for kf in (pair.query, pair.cand):
            num_after = self._tracks[kf.segment].path.num_after(kf.seq)
            if kf.segment not in self._over and num_after < PATIENCE:
                return kf.segment
        return None

    def _add(self, kf: KeyframeId, descriptions: Descriptions) -> None:
        if guards.may_be_candidate(kf.seq, self._config):
            slot = self._places.add(descriptions)
            self._tracks[kf.segment].set_slot(kf.seq, slot)
            self._indexed.append(kf)
            self.counters["indexed"] += 1
