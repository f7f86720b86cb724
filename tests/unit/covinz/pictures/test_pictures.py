"""Every picture of every kind of run: written, readable, small, the same each time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from covinz import pictures, report
from covinz.pictures import style
from covinz.pictures.subject import subject_of
from covinz.record import RunRecord
from tests.runs import Walks, made_up_run

# Wide enough apart that antialiasing does not matter, of 255.
NEAR = 12
RUNS = {
    "one robot": Walks(agents=1, loops=5),
    "two maps, no loops": Walks(agents=2, loops=0, maps=2),
    "no ground truth, four maps": Walks(agents=5, maps=4, truth=False, keyframes=20),
    "five robots flying over kilometres": Walks(
        agents=5, size_m=400.0, climb_m=60.0, plan=True, wrong=2
    ),
    "one keyframe each": Walks(keyframes=1, loops=0, maps=3),
}


QUICK = ("two maps, no loops", "five robots flying over kilometres")


@pytest.fixture(
    scope="module",
    params=[name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in RUNS],
)
def drawn(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    record = made_up_run(RUNS[request.param])
    files = pictures.draw(record, report.build(record), tmp_path_factory.mktemp("run"))
    return Drawn(record, {file.name: file for file in files})


@dataclass(frozen=True)
class Drawn:
    """A run and its pictures."""

    record: RunRecord
    files: dict[str, Path]


def share_of(file: Path, colour: str) -> float:
    """Share of a picture's pixels that have a colour, or nearly."""
    with Image.open(file) as picture:
        palette = np.array(picture.getpalette()).reshape(-1, 3)
        counts = np.bincount(np.asarray(picture).ravel(), minlength=len(palette))
    near = np.abs(palette - 255 * np.array(to_rgb(colour))).max(axis=-1) < NEAR
    return float(counts[near].sum() / counts.sum())


def draw_alone(name: str, walks: Walks, file: Path) -> Path:
    """One picture of a run."""
    record = made_up_run(walks)
    with style.applied():
        pictures.PICTURES[name](file, subject_of(record), report.build(record))
    return file


def test_all_pictures_are_there_and_fit_a_readme(drawn: Drawn) -> None:
    assert list(drawn.files) == list(pictures.PICTURES)
    for file in drawn.files.values():
        assert file.stat().st_size < 300_000
        with Image.open(file) as picture:
            width, height = picture.size
        assert width == round(style.WIDTH_IN * style.DPI)
        assert 0.2 * width < height < 1.6 * width


@pytest.mark.parametrize("name", ["top_view.png", "map_3d.png", "error_over_time.png"])
def test_every_robot_is_seen_in_its_colour_on_white(drawn: Drawn, name: str) -> None:
    assert share_of(drawn.files[name], "#FFFFFF") > 0.5
    for colour in style.AGENT_COLOURS[: len(drawn.record.played)]:
        assert share_of(drawn.files[name], colour) > 0.00003


def test_truth_is_drawn_where_it_is_known(drawn: Drawn) -> None:
    moved = len(drawn.record.snapshots[0].keyframes) > 3
    seen = share_of(drawn.files["top_view.png"], style.TRUTH) > 0.002
    assert seen == (bool(drawn.record.groundtruth) and moved)


@pytest.mark.parametrize("name", list(pictures.PICTURES))
def test_the_same_run_gives_the_same_bytes(name: str, tmp_path: Path) -> None:
    walks = Walks(agents=2, plan=True, wrong=1)
    once = draw_alone(name, walks, tmp_path / "once.png")
    again = draw_alone(name, walks, tmp_path / "again.png")
    assert once.read_bytes() == again.read_bytes()


@pytest.mark.parametrize("name", list(pictures.PICTURES))
def test_a_wrong_loop_is_red_and_only_a_wrong_one(name: str, tmp_path: Path) -> None:
    walks = Walks(agents=3, size_m=8.0, loops=40)
    right = draw_alone(name, walks, tmp_path / "right.png")
    wrong = draw_alone(name, replace(walks, wrong=16), tmp_path / "wrong.png")
    # The limit in the histogram is dotted red whether a loop is beyond it or not.
    assert share_of(right, style.WRONG) < 0.0002 < share_of(wrong, style.WRONG)


def test_the_plan_lies_below_the_robots(tmp_path: Path) -> None:
    walks = Walks(agents=1, loops=0)
    plain, planned = (
        draw_alone("top_view.png", replace(walks, plan=plan), tmp_path / f"{plan}.png")
        for plan in (False, True)
    )
    assert share_of(plain, style.PLAN_FACE) < 0.01 < 0.03 < share_of(planned, style.PLAN_FACE)


def test_nothing_is_drawn_where_nothing_was_mapped(tmp_path: Path) -> None:
    empty = RunRecord([], [], {}, {}, 1.0)
    assert pictures.draw(empty, report.build(empty), tmp_path) == []
    assert list(tmp_path.iterdir()) == []
