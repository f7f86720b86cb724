"""Several kinds of features: each finds its own, and ranks are merged, not scores."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from covinz.config import FeatureKind, LoopSolverConfig, PlaceRecognitionConfig
from covinz.types import FeatureType, Keyframe, KeyframeId, LogEntry
from services.place_recognition.places import Places

ORB, SIFT = FeatureType.ORB, FeatureType.SIFT
Kid = Callable[[str, int], KeyframeId]
LogOf = Callable[[Iterable[Keyframe]], list[LogEntry]]
EVERYTHING = np.ones(100, dtype=bool)


def places_of(world: Any, *kinds: FeatureKind, **options: object) -> Places:
    values = {"min_score": 1.0, "min_score_ratio": 0.0, **options}
    config = PlaceRecognitionConfig.model_validate(values)
    return Places(config, kinds, {"orb": world.vocabulary, "sift": world.sift_vocabulary})


def slots(places: Places, kf: Keyframe) -> list[int]:
    found = places.best(places.describe(kf), EVERYTHING[: len(places)])
    assert all(score >= 1.0 for _, score in found)
    return [slot for slot, _ in found]


def test_each_kind_finds_its_own(world: Any) -> None:
    places = places_of(world, "sift", "orb", num_candidates=1)
    stored = [("a", 0, 1, ORB), ("a", 1, 2, SIFT), ("b", 0, 1, SIFT), ("b", 1, 2, ORB)]
    for name, seq, place, kind in stored:
        places.add(places.describe(world.keyframe(name, seq, place, kind=kind)))
    assert len(places) == 4
    assert slots(places, world.keyframe("c", 0, 1, kind=ORB)) == [0]
    assert slots(places, world.keyframe("c", 1, 1, kind=SIFT)) == [2]
    assert slots(places, world.keyframe("c", 2, 2, kind=SIFT)) == [1]


def test_ranks_of_two_kinds_take_turns(world: Any) -> None:
    """Slot 0 shows place 1 by ORB alone, slot 1 by SIFT alone, slot 2 by both and less of it."""
    places = places_of(world, "sift", "orb")
    places.add(places.describe(world.keyframe("a", 0, 1, kind=ORB)))
    places.add(places.describe(world.keyframe("a", 1, 1, kind=SIFT)))
    places.add(places.describe(world.keyframe("a", 2, 1, 40, kind=ORB, also=SIFT)))
    for seq in range(3, 8):
        places.add(places.describe(world.keyframe("a", seq, seq, kind=ORB, also=SIFT)))
    query = world.keyframe("b", 0, 1, kind=ORB, also=SIFT)
    assert slots(places, query)[:3] == [1, 0, 2]
    mask = EVERYTHING[: len(places)].copy()
    mask[0] = False
    found = places.best(places.describe(query), mask)
    assert [slot for slot, _ in found][:2] == [1, 2]


def test_the_number_of_candidates_is_for_all_kinds_together(world: Any) -> None:
    places = places_of(world, "sift", "orb", num_candidates=3)
    for seq in range(5):
        kind, also = (ORB, SIFT) if seq % 2 else (SIFT, ORB)
        places.add(places.describe(world.keyframe("a", seq, 1, kind=kind, also=also)))
    assert slots(places, world.keyframe("b", 0, 1, kind=ORB)) == []  # seen everywhere: no weight
    for seq in range(5, 10):
        places.add(places.describe(world.keyframe("a", seq, seq, kind=ORB, also=SIFT)))
    assert slots(places, world.keyframe("b", 0, 1, kind=ORB, also=SIFT)) == [0, 1, 2]


def test_too_few_features_of_one_kind_leave_the_other(world: Any) -> None:
    places = places_of(world, "sift", "orb", min_features=50)
    kf = world.keyframe("a", 0, 1)
    assert set(places.describe(kf)) == {"orb"}
    assert not places.describe(world.keyframe("a", 1, 1, 40, kind=SIFT))
    assert not places_of(world, "sift").describe(kf)


def test_thresholds_of_a_kind_are_its_own(world: Any) -> None:
    places = places_of(world, "sift", "orb", sift={"min_score": 1e6})
    for seq in range(6):
        places.add(places.describe(world.keyframe("a", seq, seq, kind=ORB, also=SIFT)))
    assert slots(places, world.keyframe("b", 0, 1, kind=ORB)) == [1]
    assert slots(places, world.keyframe("b", 0, 1, kind=SIFT)) == []


def test_identity_names_the_kinds_and_their_vocabularies(world: Any) -> None:
    both, one = places_of(world, "sift", "orb"), places_of(world, "orb")
    assert one.identity == f"orb:{world.vocabulary.hash}"
    assert both.identity == f"sift:{world.sift_vocabulary.hash} {one.identity}"


def test_jobs_of_two_kinds_come_out_the_same_again(
    world: Any, log_of: LogOf, kid: Kid, describe: Any
) -> None:
    """Robot a sends both kinds, b one, c the other: all meet, b and c only through a."""
    keyframes = [
        *(world.keyframe("a", seq, seq, kind=ORB, also=SIFT) for seq in range(4)),
        *(world.keyframe("b", seq, place) for seq, place in enumerate((8, 2, 9))),
        *(world.keyframe("c", seq, place, kind=SIFT) for seq, place in enumerate((10, 2, 11))),
    ]
    entries = log_of(keyframes)
    runs = []
    for _ in range(2):
        recognizer = world.recognizer(num_candidates=2)
        runs.append([job for entry in entries for job in recognizer.process(entry)])
    assert describe(runs[0]) == describe(runs[1])
    assert [(job.query, job.cand) for job in runs[0]] == [
        (kid("b", 1), kid("a", 2)),
        (kid("c", 1), kid("a", 2)),
    ]


def test_kinds_in_use_are_part_of_a_jobs_identity(world: Any, log_of: LogOf) -> None:
    keyframes = [world.keyframe("a", seq, seq) for seq in range(4)]
    keyframes += [world.keyframe("b", seq, place) for seq, place in enumerate((8, 2, 9))]
    ids = set()
    for kinds in (("orb",), ("sift", "orb"), ("orb", "sift")):
        recognizer = world.recognizer(LoopSolverConfig(kinds=kinds))
        (job,) = (job for entry in log_of(keyframes) for job in recognizer.process(entry))
        ids.add(job.id)
    assert len(ids) == 3
