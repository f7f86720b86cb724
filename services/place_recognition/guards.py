"""Which keyframes may be queried and which may be candidates.

Every decision is a function of the log up to the query and never of an outcome, so the job list
is the same with one worker or eight and after any crash.

Source: docs/architecture.md; parameters of the public code in docs/paper.md (place recognition).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from covinz.config import PlaceRecognitionConfig
from covinz.types import KeyframeId
from services.place_recognition.track import QueryHistory, Track


def may_query(
    seq: int, track: Track, history: QueryHistory, config: PlaceRecognitionConfig
) -> bool:
    """Whether a keyframe is looked up at all.

    It is not when it is one of the session's first `start_after_keyframes`, or too near, in
    keyframes, seconds or metres of path, to a query of its session that gave candidates.
    """
    if seq < config.start_after_keyframes:
        return False
    spacing = (config.query_spacing_keyframes, config.query_spacing_s, config.query_spacing_m)
    if not history.productive or not any(spacing):
        return True
    far = track.distances(seq)
    near = (
        (far.keyframes <= config.query_spacing_keyframes)
        | (far.seconds < config.query_spacing_s)
        | (far.metres < config.query_spacing_m)
    )
    return not np.isin(track.seqs, history.productive)[near].any()


def may_be_candidate(seq: int, config: PlaceRecognitionConfig) -> bool:
    """Whether a keyframe is put into the index: a session's first ones may be kept out."""
    return seq >= config.exclude_first_keyframes


def eligible(
    query: KeyframeId, size: int, tracks: Iterable[Track], config: PlaceRecognitionConfig
) -> NDArray[np.bool_]:
    """Mask (size,) of the index's slots that may answer a query.

    Args:
        query: The keyframe that is looked up.
        size: Number of keyframes in the index.
        tracks: All sessions of the query's agent, its own among them.
        config: Guards; candidates of the query's own session are far in keyframes, in seconds
            and in metres of path.
    """
    mask = np.ones(size, dtype=bool)
    for track in tracks:
        if config.other_agents_only:
            blocked = np.ones(len(track), dtype=bool)
        elif track.segment == query.segment:
            blocked = _too_near(query.seq, track, config)
        else:
            continue
        slots = np.array(track.slots, dtype=np.int64)
        mask[slots[blocked & (slots >= 0)]] = False
    return mask


def consistent(
    candidate: KeyframeId, seq: int, history: QueryHistory, config: PlaceRecognitionConfig
) -> bool:
    """Whether the queries before `seq` in its session saw the candidate's surroundings too.

    With `consistent_queries` = n, each of the n nearest preceding queries must have had a
    candidate within n keyframes of this one.

    Source: temporal consistency of DBoW2-style loop detection; public code:
    ``cov_consistency_thres``.
    """
    wanted = config.consistent_queries
    past = history.preceding(seq, wanted)
    return len(past) == wanted and all(
        any(
            other.segment == candidate.segment and abs(other.seq - candidate.seq) <= wanted
            for other in query.candidates
        )
        for query in past
    )


def _too_near(seq: int, track: Track, config: PlaceRecognitionConfig) -> NDArray[np.bool_]:
    far = track.distances(seq)
    return (
        (far.keyframes < config.min_loop_keyframes)
        | (far.seconds < config.min_loop_s)
        | (far.metres < config.min_loop_m)
    )
