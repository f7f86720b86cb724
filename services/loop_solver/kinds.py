"""Which kind of feature a job is solved with: one that all keyframes of both rigs have.

Keyframes of two kinds are matched by one of them, not by both: a point that two detectors find
is not two measurements, and would count twice for the inliers asked for and for the covariance.

Source: decision 0022.
"""

from __future__ import annotations

from collections.abc import Sequence

from covinz.config import FeatureKind
from covinz.keyframes import KeyframeStore
from covinz.types import FeatureType, LoopJob, RigMember


class NoSharedKind(ValueError):
    """The two sides of a job have no kind of feature in common that the solver may use."""


class FeaturesExpired(ValueError):
    """A keyframe of a job has lost its features: the log was too large, or too old."""


def shared_kind(
    job: LoopJob, store: KeyframeStore, preferred: Sequence[FeatureKind]
) -> FeatureType:
    """The first of the preferred kinds that every keyframe of both rigs has.

    Raises:
        FeaturesExpired: If a keyframe has no features any more.
        NoSharedKind: If there is none; the message says what each side has.
        KeyframeNotFound, StoreUnavailable: From the store.
    """
    query, cand = _of_all(job.query_rig, store), _of_all(job.cand_rig, store)
    for name in preferred:
        kind = FeatureType[name.upper()]
        if kind in query and kind in cand:
            return kind
    raise NoSharedKind(
        f"all keyframes of the query's rig have {_names(query)}, of the candidate's {_names(cand)}"
        f"; in use: {', '.join(preferred)}"
    )


def _of_all(members: Sequence[RigMember], store: KeyframeStore) -> set[FeatureType]:
    """Kinds that all keyframes of a rig have."""
    keyframes = [store.keyframe(member.keyframe) for member in members]
    for kf in keyframes:
        if kf.features is None:
            raise FeaturesExpired(f"the features of {kf.id} were dropped from the log")
    return set.intersection(*({block.type for block in kf.all_features} for kf in keyframes))


def _names(kinds: set[FeatureType]) -> str:
    return ", ".join(sorted(kind.name.lower() for kind in kinds)) or "no kind in common"
