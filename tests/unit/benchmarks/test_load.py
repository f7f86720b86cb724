"""What the load benchmark makes of what its robots saw, and the keyframes that they play."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from benchmarks import fuzz_decoding, load_recordings
from benchmarks.fleet import Fleet
from benchmarks.load import report
from benchmarks.load_uploads import upload_figures
from covinz import codec
from covinz.codec.layout import IDENTIFIERS
from covinz.types import Keyframe, KeyframeId
from tests.contract.examples import EXAMPLES, KEYFRAME


def robot(due_s: list[float], acked_s: list[float | None], corrected: Any = ()) -> dict[str, Any]:
    return {"due_s": due_s, "acked_s": acked_s, "corrected": corrected}


def test_figures_count_from_when_a_keyframe_was_due() -> None:
    one = robot([0.0, 1.0, 2.0], [0.5, 1.25, 2.75], [(1.5, 0), (3.0, 2), (4.0, 1)])
    two = robot([1.0, 1.5], [1.1, None])
    played = [
        {"answers": {"Stored": 3}, "robots": [one]},
        {"answers": {"Stored": 1, "Rejected": 1}, "robots": [two]},
    ]
    made = upload_figures(played, 1.0, 2.0)
    assert made["answers"] == {"Rejected": 1, "Stored": 4}
    # Due in the second that counts: the second keyframe of one, both of two.
    assert (made["keyframes_due"], made["keyframes_accepted"]) == (3, 2)
    assert made["keyframes_per_s"] == 2.0
    assert (made["ack_p50_ms"], made["ack_max_ms"]) == (175.0, 250.0)
    # The correction that names a later keyframe was computed with this one too.
    assert (made["keyframes_corrected"], made["keyframe_to_correction_p50_ms"]) == (1, 2000.0)


def test_nothing_is_made_up_where_nothing_came() -> None:
    made = upload_figures([{"answers": {}, "robots": [robot([1.0], [None])]}], 0.0, 2.0)
    assert made["ack_p99_ms"] is None
    assert made["keyframe_to_correction_p50_ms"] is None


@pytest.fixture
def recordings(tmp_path: Path) -> load_recordings.Recordings:
    keyframes = {}
    for seq in range(3):
        name = KeyframeId("robot", KEYFRAME.id.session, seq)
        keyframes[name] = dataclasses.replace(KEYFRAME, id=name, thumbnail_jpeg=bytes([seq]))
    camera = EXAMPLES["Camera"]
    load_recordings.write(tmp_path, Fleet({}, keyframes, {camera.hash: camera}, {}, {}))
    return load_recordings.read(tmp_path)


def test_robots_play_recordings_there_and_back(recordings: load_recordings.Recordings) -> None:
    played = [codec.decode(recordings.played(0, seq), Keyframe) for seq in range(6)]
    assert [kf.thumbnail_jpeg for kf in played] == [bytes([at]) for at in (0, 1, 2, 1, 0, 1)]
    assert [kf.id.seq for kf in played] == list(range(6))
    stamps = [kf.stamp_ns for kf in played]
    assert stamps == sorted(set(stamps))
    assert set(recordings.cameras) == {EXAMPLES["Camera"].hash}


def test_robots_are_different_ones(recordings: load_recordings.Recordings) -> None:
    names = {codec.decode(recordings.played(n, 0), Keyframe).id for n in range(60)}
    assert len({(name.agent, name.session) for name in names}) == 60


def test_parts_make_one_report() -> None:
    uploads = upload_figures([{"answers": {}, "robots": [robot([1.0], [1.5])]}], 0.0, 2.0)
    made = report({"uploads": uploads, "dispatch": {"scaling": 7.5}})
    assert (made["ack_p99_ms"], made["dispatch_scaling_1_to_8"]) == (500.0, 7.5)
    assert "solving_scaling_1_to_2" not in made
    made = report({"solving": {"scaling": 1.75}, "solving_at_once": {"scaling": 1.25}})
    assert made["solving_scaling_1_to_2"] == 1.75
    assert made["solving_at_once_scaling_1_to_2"] == 1.25


def test_fuzzing_runs_add_up() -> None:
    runs = [fuzz_decoding.run(400, seed, None)[1] for seed in (1, 2)]
    totals = fuzz_decoding.report(runs)["totals"]
    assert totals["decodes"] == 800 == totals["accepted"] + totals["refused"]
    assert totals["findings"] == 0
    assert totals["message_types"] == len(IDENTIFIERS)
