from __future__ import annotations

import numpy as np

from covinz.types import KeyframeId, LoopJob, RigMember
from services.place_recognition.locality import MAX_WORKERS, Locality

SESSION = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
CAPACITY = 64


def job(*seqs: int) -> LoopJob:
    """A job whose candidate's rig is the first keyframe, and the query's rig the others."""
    members = [
        RigMember(KeyframeId("a", SESSION, seq), np.eye(4), "0123456789abcdef") for seq in seqs
    ]
    return LoopJob("0" * 32, tuple(members[1:]), (members[0],), 1.0)


def test_a_worker_knows_the_keyframes_of_both_rigs_of_its_jobs() -> None:
    locality = Locality(CAPACITY)
    locality.lent("one", job(1, 2, 3))
    assert locality.num_known("one", job(3, 4, 1)) == 2
    assert locality.num_known("one", job(4, 5)) == 0
    assert locality.num_known("two", job(1, 2, 3)) == 0


def test_a_worker_that_vanished_knows_nothing() -> None:
    locality = Locality(CAPACITY)
    locality.lent("one", job(1, 2))
    locality.lent("two", job(1, 2))
    locality.gone("one")
    locality.gone("never there")
    assert locality.num_known("one", job(1, 2)) == 0
    assert locality.num_known("two", job(1, 2)) == 2


def test_what_was_used_longest_ago_is_forgotten() -> None:
    locality = Locality(CAPACITY)
    locality.lent("one", job(-1, -2))
    for seq in range(0, CAPACITY - 2, 2):
        locality.lent("one", job(seq, seq + 1))
    locality.lent("one", job(-1, -2))  # used once more
    locality.lent("one", job(10_000, 10_001))
    assert locality.num_known("one", job(-1, -2)) == 2
    assert locality.num_known("one", job(0, 1)) == 0
    assert locality.num_known("one", job(2, 3)) == 2


def test_of_too_many_workers_those_seen_longest_ago_are_forgotten() -> None:
    locality = Locality(CAPACITY)
    for worker in range(MAX_WORKERS):
        locality.lent(f"worker-{worker}", job(1, 2))
    locality.lent("worker-0", job(1, 2))
    locality.lent("another", job(1, 2))
    assert locality.num_known("worker-0", job(1, 2)) == 2
    assert locality.num_known("worker-1", job(1, 2)) == 0
