from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from covinz import codec
from covinz.config import ConfigError, FeatureKind, LoopSolverConfig, PlaceRecognitionConfig
from covinz.types import FeatureType, Gap, Keyframe, KeyframeId, LogEntry, LoopJob
from services.place_recognition.index import load_vocabulary
from services.place_recognition.places import best
from services.place_recognition.recognizer import Recognizer

Kid = Callable[[str, int], KeyframeId]
LogOf = Callable[[Iterable[Keyframe]], list[LogEntry]]
Describe = Callable[[Iterable[LoopJob]], list[object]]
# Agent, sequence number, place.
Visit = tuple[str, int, int]


def log(world: Any, log_of: LogOf, visits: Iterable[Visit]) -> list[LogEntry]:
    return log_of(world.keyframe(*visit) for visit in visits)


def jobs_by_entry(recognizer: Recognizer, entries: Iterable[LogEntry]) -> list[list[LoopJob]]:
    return [recognizer.process(entry) for entry in entries]


def walk(name: str, places: Iterable[int]) -> list[Visit]:
    return [(name, seq, place) for seq, place in enumerate(places)]


def pairs(jobs: Iterable[LoopJob]) -> list[tuple[KeyframeId, KeyframeId]]:
    return [(job.query, job.cand) for job in jobs]


def rig_seqs(job: LoopJob) -> tuple[list[int], list[int]]:
    return (
        [m.keyframe.seq for m in job.query_rig],
        [m.keyframe.seq for m in job.cand_rig],
    )


def test_a_place_seen_again_becomes_a_job(world: Any, log_of: LogOf, kid: Kid) -> None:
    recognizer = world.recognizer()
    visits = [*walk("a", [0, 1, 2, 3]), *walk("b", [8, 2])]
    found = jobs_by_entry(recognizer, log(world, log_of, visits))
    assert [len(jobs) for jobs in found] == [0, 0, 0, 0, 0, 1]
    (job,) = found[-1]
    assert pairs([job]) == [(kid("b", 1), kid("a", 2))]
    assert rig_seqs(job) == ([1, 0], [2, 0, 1])
    assert job.score > 60 * np.log(5 / 2)
    assert recognizer.counters["candidates"] == 1
    assert recognizer.counters["indexed"] == 6


def test_members_carry_pose_and_camera(world: Any, log_of: LogOf) -> None:
    visits = [*walk("a", [0, 1, 2, 3]), *walk("b", [8, 2])]
    entries = log(world, log_of, visits)
    (job,) = jobs_by_entry(world.recognizer(), entries)[-1]
    sent = {entry.item.id: entry.item for entry in entries if isinstance(entry.item, Keyframe)}
    for member in (*job.query_rig, *job.cand_rig):
        np.testing.assert_array_equal(member.T_odom_body, sent[member.keyframe].T_odom_body)
        assert member.camera_hash == sent[member.keyframe].camera_hash


def test_a_first_keyframe_s_job_comes_with_its_successor(
    world: Any, log_of: LogOf, kid: Kid
) -> None:
    recognizer = world.recognizer()
    visits = [*walk("a", [0, 1, 2]), ("b", 0, 1), ("a", 3, 4), ("b", 1, 8)]
    entries = log(world, log_of, visits)
    found = jobs_by_entry(recognizer, entries[:-1])
    assert [len(jobs) for jobs in found] == [0] * 5
    assert recognizer.waiting == 1
    (job,) = recognizer.process(entries[-1])
    assert pairs([job]) == [(kid("b", 0), kid("a", 1))]
    assert rig_seqs(job) == ([0, 1], [1, 0, 2])
    assert recognizer.waiting == 0


def test_a_candidate_in_a_short_session_waits_for_its_neighbours(
    world: Any, log_of: LogOf, kid: Kid
) -> None:
    recognizer = world.recognizer()
    # Distractors give the votes their idf weight.
    visits = [*walk("d", [9, 10, 11]), *walk("a", [0, 1]), ("b", 0, 8), ("b", 1, 0)]
    entries = log(world, log_of, [*visits, ("a", 2, 4)])
    assert not any(jobs_by_entry(recognizer, entries[:-1]))
    assert recognizer.waiting == 1
    (job,) = recognizer.process(entries[-1])
    assert pairs([job]) == [(kid("b", 1), kid("a", 0))]
    # Fixed when the job is made: the candidate's two successors.
    assert rig_seqs(job) == ([1, 0], [0, 1, 2])


def test_both_sides_may_have_to_wait(world: Any, log_of: LogOf, kid: Kid) -> None:
    recognizer = world.recognizer()
    visits = [*walk("d", [9, 10, 11]), ("a", 0, 0), ("b", 0, 0)]
    later: list[Visit] = [("a", 1, 4), ("b", 1, 5), ("a", 2, 6)]
    found = jobs_by_entry(recognizer, log(world, log_of, [*visits, *later]))
    assert [len(jobs) for jobs in found] == [0] * 7 + [1]
    assert pairs(found[-1]) == [(kid("b", 0), kid("a", 0))]


def test_unusable_keyframes_take_no_part(world: Any, log_of: LogOf, kid: Kid) -> None:
    keyframes = [
        world.keyframe("a", 0, 0),
        world.keyframe("a", 1, 1),
        world.keyframe("a", 2, 7, num_features=29),
        world.keyframe("a", 3, 2),
        world.keyframe("b", 0, 8),
        world.keyframe("b", 1, 3, kind=FeatureType.SIFT),
        world.keyframe("b", 2, 7),
        world.keyframe("b", 3, 1),
    ]
    recognizer = world.recognizer(LoopSolverConfig(kinds=("orb",)))
    found = jobs_by_entry(recognizer, log_of(keyframes))
    (job,) = [job for jobs in found for job in jobs]
    assert pairs([job]) == [(kid("b", 3), kid("a", 1))]
    assert rig_seqs(job) == ([3, 2], [1, 0, 3])
    assert recognizer.counters["skipped.few_features"] == 1
    assert recognizer.counters["skipped.feature_type"] == 1
    assert recognizer.counters["indexed"] == 6


def test_a_gap_is_only_passed_over(world: Any, kid: Kid) -> None:
    first = kid("a", 0)
    gap = Gap(first.agent, first.session, 3, 5, "spool overflow")
    assert world.recognizer().process(LogEntry(0, gap)) == []


def test_rigs_that_share_a_keyframe_are_no_loop(world: Any, log_of: LogOf) -> None:
    # A hole in the session: the candidate's successor is the query's predecessor.
    visits: list[Visit] = [*walk("d", [9, 10, 11]), ("a", 0, 0), ("a", 30, 5), ("a", 31, 0)]
    recognizer = world.recognizer(LoopSolverConfig(profile="paper"), min_loop_keyframes=20)
    assert not any(jobs_by_entry(recognizer, log(world, log_of, visits)))
    assert recognizer.counters["skipped.overlap"] == 1


def test_spacing_counts_from_queries_with_candidates(world: Any, log_of: LogOf, kid: Kid) -> None:
    visits = [*walk("a", [0, 1, 2, 3, 4, 5]), *walk("b", [8, 1, 2, 3, 4, 5])]
    recognizer = world.recognizer(query_spacing_keyframes=2, num_candidates=1)
    found = jobs_by_entry(recognizer, log(world, log_of, visits))
    queries = [job.query for jobs in found for job in jobs]
    assert queries == [kid("b", 1), kid("b", 4)]
    assert recognizer.counters["not_queried"] == 2 + 1


def test_consistency_delays_the_first_candidates(world: Any, log_of: LogOf, kid: Kid) -> None:
    visits = [*walk("a", [0, 1, 2, 3, 4, 5]), *walk("b", [8, 1, 2, 3, 4])]
    recognizer = world.recognizer(consistent_queries=2)
    found = jobs_by_entry(recognizer, log(world, log_of, visits))
    queries = [job.query for jobs in found for job in jobs]
    assert queries == [kid("b", 3), kid("b", 4)]


def test_tf_idf_ranks_too(world: Any, log_of: LogOf, kid: Kid) -> None:
    recognizer = world.recognizer(score="tf_idf", min_score=0.3)
    visits = [*walk("a", [0, 1, 2, 3]), *walk("b", [8, 2])]
    jobs = jobs_by_entry(recognizer, log(world, log_of, visits))[-1]
    assert jobs[0].cand == kid("a", 2)
    assert jobs[0].score == pytest.approx(1.0)
    # So few words make every place look a little like every other.
    assert all(0.3 <= job.score < 0.9 for job in jobs[1:])


def test_tf_idf_with_a_threshold_for_votes_is_refused(world: Any) -> None:
    with pytest.raises(ConfigError, match="tf_idf scores are at most 1"):
        world.recognizer(score="tf_idf", min_score=10.0)


@pytest.mark.parametrize("kind", ["orb", "sift"])
def test_a_missing_or_broken_vocabulary_is_a_config_error(tmp_path: Any, kind: FeatureKind) -> None:
    (tmp_path / "broken.bin").write_bytes(b"no vocabulary")
    for path in (tmp_path / "nowhere.bin", tmp_path / "broken.bin"):
        values = {"vocabulary": path, "sift": {"vocabulary": path}}
        with pytest.raises(ConfigError, match="vocabulary"):
            load_vocabulary(PlaceRecognitionConfig.model_validate(values), kind)


def test_a_vocabulary_of_the_other_kind_is_a_config_error() -> None:
    config = PlaceRecognitionConfig()
    swapped = {"vocabulary": config.sift.vocabulary, "sift": {"vocabulary": config.vocabulary}}
    values = PlaceRecognitionConfig.model_validate(swapped)
    with pytest.raises(ConfigError, match="128-byte descriptors"):
        load_vocabulary(values, "orb")
    with pytest.raises(ConfigError, match="32-byte descriptors"):
        load_vocabulary(values, "sift")


def test_ranking() -> None:
    def rank(scores: list[float], mask: list[bool] | None = None, **options: float) -> list[int]:
        values = {"min_score": 1.0, "min_score_ratio": 0.0, "num_candidates": 9, **options}
        config = PlaceRecognitionConfig.model_validate(values)
        array = np.array(scores, dtype=np.float32)
        eligible = np.array(mask or [True] * len(scores), dtype=bool)
        return best(array, eligible, config, config.min_score)

    assert rank([]) == []
    assert rank([3, 5, 5, 4]) == [1, 2, 3, 0]
    assert rank([5] * 4, num_candidates=2) == [0, 1]
    assert rank([0.9, 1.0, 2.0]) == [2, 1]
    assert rank([0.0, 0.1], min_score=0.0) == [1]
    assert rank([1, 2, 4, 8], min_score_ratio=0.5) == [3, 2]
    # The best eligible score counts, not one that the guards have excluded.
    assert rank([1, 2, 4, 8], [True, True, True, False], min_score_ratio=0.5) == [2, 1]
    assert rank([8], [False]) == []


@st.composite
def logs(draw: st.DrawFn) -> list[Visit]:
    """Sessions of three agents, interleaved, out of order and with gaps."""
    visits: list[Visit] = []
    for name in ("a", "b", "c", "a2"):
        seqs = draw(st.lists(st.integers(0, 9), max_size=6, unique=True))
        visits += [(name, seq, draw(st.integers(0, 5))) for seq in seqs]
    return draw(st.permutations(visits))


@settings(deadline=None)
@given(logs(), st.integers(0, 24))
def test_jobs_are_a_function_of_the_log_so_far(
    world: Any, log_of: LogOf, describe: Describe, visits: list[Visit], cut: int
) -> None:
    options = {"min_loop_keyframes": 3, "query_spacing_keyframes": 1, "num_candidates": 3}
    entries = log(world, log_of, visits)
    found = jobs_by_entry(world.recognizer(**options), entries)
    again = jobs_by_entry(world.recognizer(**options), entries[:cut])
    assert [describe(jobs) for jobs in again] == [describe(jobs) for jobs in found[:cut]]


@settings(deadline=None)
@given(logs())
def test_every_job_is_well_formed(world: Any, log_of: LogOf, visits: list[Visit]) -> None:
    seen: set[KeyframeId] = set()
    recognizer = world.recognizer(min_loop_keyframes=3, num_candidates=3)
    ids = []
    for entry in log(world, log_of, visits):
        assert isinstance(entry.item, Keyframe)
        seen.add(entry.item.id)
        for job in recognizer.process(entry):
            ids.append(job.id)
            query = [m.keyframe for m in job.query_rig]
            cand = [m.keyframe for m in job.cand_rig]
            assert (len(query), len(cand)) == (2, 3)
            assert len(set(query + cand)) == 5
            assert set(query + cand) <= seen
            assert {k.segment for k in query} == {job.query.segment}
            assert {k.segment for k in cand} == {job.cand.segment}
            if job.query.segment == job.cand.segment:
                assert abs(job.query.seq - job.cand.seq) >= 3
    assert len(ids) == len(set(ids))


def test_solver_configuration_changes_every_id(
    world: Any, log_of: LogOf, describe: Describe
) -> None:
    entries = log(world, log_of, [*walk("a", [0, 1, 2, 3]), *walk("b", [8, 2])])
    (plain,) = jobs_by_entry(world.recognizer(), entries)[-1]
    strict = LoopSolverConfig(min_rig_inliers=150)
    (other,) = jobs_by_entry(world.recognizer(solver=strict), entries)[-1]
    assert plain.id != other.id and plain.seed != other.seed
    assert describe([plain])[0][1:] == describe([other])[0][1:]  # type: ignore[index]


def test_keyframes_that_lost_their_features_take_no_part_and_the_rest_is_as_it_was(
    world: Any, log_of: LogOf, kid: Kid
) -> None:
    visits = [*walk("a", [0, 1, 2, 3]), *walk("b", [8, 2, 9, 3])]
    entries = log(world, log_of, visits)
    found = [pairs(jobs) for jobs in jobs_by_entry(world.recognizer(), entries)]
    assert found[5] == [(kid("b", 1), kid("a", 2))]
    assert found[7] == [(kid("b", 3), kid("a", 3))]
    kept = [
        LogEntry(entry.log_index, codec.without_features(entry.item))
        if entry.log_index < 2 and isinstance(entry.item, Keyframe)
        else entry
        for entry in entries
    ]
    recognizer, other = world.recognizer(), world.recognizer()
    again = jobs_by_entry(recognizer, kept)
    assert recognizer.counters["skipped.features_expired"] == 2
    assert again[5] == []  # too few of the candidate's neighbours are left for its rig
    named = {member.keyframe for jobs in again for job in jobs for member in job.cand_rig}
    assert named <= {kid("a", 2), kid("a", 3), *(kid("b", seq) for seq in range(4))}
    assert [[job.id for job in jobs] for jobs in jobs_by_entry(other, kept)] == [
        [job.id for job in jobs] for jobs in again
    ]
