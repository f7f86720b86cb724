"""TUM files: exact time stamps, typed errors with file and line, bounded interpolation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz import frames
from covinz.trajectory import (
    Trajectory,
    TrajectoryError,
    format_stamp_ns,
    parse_stamp_ns,
    read_tum,
    write_tum,
)

LINE = "1.5 1 2 3 0 0 0 1\n"


def turning(stamps_ns: list[int]) -> Trajectory:
    """One metre and 0.2 rad about z per second."""
    seconds = np.array(stamps_ns) * 1e-9
    R = frames.so3_exp(seconds[:, None] * [0, 0, 0.2])
    return Trajectory(np.array(stamps_ns), frames.transform(R, seconds[:, None] * [1.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1403636580.838560001", 1403636580838560001),
        ("1000000000.066667", 1000000000066667000),
        ("12", 12_000_000_000),
        ("0.5", 500_000_000),
        ("3.", 3_000_000_000),
        ("0.9999999994", 999_999_999),
        ("0.9999999995", 1_000_000_000),
    ],
)
def test_stamps_are_exact_decimals(text: str, stamp_ns: int) -> None:
    assert parse_stamp_ns(text) == stamp_ns


@pytest.mark.parametrize(
    "text", ["", ".5", "-1.0", "1e9", "nan", "1,5", "1.5s", " 1", "9999999999"]
)
def test_other_texts_are_no_stamps(text: str) -> None:
    with pytest.raises(ValueError, match="not a time stamp"):
        parse_stamp_ns(text)


@given(st.integers(min_value=0, max_value=2**63 - 1))
def test_format_and_parse_are_inverse(stamp_ns: int) -> None:
    assert parse_stamp_ns(format_stamp_ns(stamp_ns)) == stamp_ns


def test_a_file_read_back_is_the_same(tmp_path: Path) -> None:
    written = turning([1403636580838560001, 1403636580838560002, 1403636590000000000])
    path = tmp_path / "a.tum"
    write_tum(path, written, "T_map_body\nof agent0")
    read = read_tum(path)
    assert path.read_text().startswith("# T_map_body\n# of agent0\n1403636580.838560001 ")
    assert np.array_equal(read.stamps_ns, written.stamps_ns)
    assert np.allclose(read.T_ref_body, written.T_ref_body, atol=2e-9, rtol=1e-8)


def test_an_empty_trajectory_can_be_written_and_read(tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", Trajectory(np.empty(0, np.int64), np.empty((0, 4, 4))))
    assert len(read_tum(tmp_path / "a.tum")) == 0


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1.6 1 2 3 0 0 0\n", "expected 8 columns, got 7"),
        ("x 1 2 3 0 0 0 1\n", "not a time stamp"),
        ("1.6 1 2 y 0 0 0 1\n", "could not convert"),
        ("1.6 1 2 nan 0 0 0 1\n", "not a finite pose"),
        ("1.6 1 2 3 0 0 0 0\n", "unit quaternion"),
        ("1.5 1 2 3 0 0 0 1\n", "must ascend"),
        ("1.4 1 2 3 0 0 0 1\n", "must ascend"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "bad.tum"
    path.write_text("# comment\n\n" + LINE + line)
    with pytest.raises(TrajectoryError, match=message) as caught:
        read_tum(path)
    assert str(caught.value).startswith(f"{path}:4: ")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match=r"cannot read .*gone\.tum"):
        read_tum(tmp_path / "gone.tum")


def test_at_is_exact_on_stamps_and_interpolates_between() -> None:
    trajectory = turning([0, 1_000_000_000, 5_000_000_000])
    second = 1_000_000_000
    exact, halfway = trajectory.at(second, 0), trajectory.at(second // 2, second)
    assert exact is not None
    assert halfway is not None
    assert np.array_equal(exact, trajectory.T_ref_body[1])
    assert np.allclose(halfway[:3, 3], [0.5, 0, 0])
    assert frames.rotation_angle(halfway) == pytest.approx(0.1)


def test_at_gives_nothing_outside_or_across_a_gap() -> None:
    trajectory = turning([10, 20, 100])
    assert trajectory.at(9, 1000) is None
    assert trajectory.at(101, 1000) is None
    assert trajectory.at(50, 79) is None
    assert trajectory.at(50, 80) is not None
    poses, indices = trajectory.sample([5, 10, 15, 50, 100], 10)
    assert indices.tolist() == [1, 2, 4]
    assert np.array_equal(poses[2], trajectory.T_ref_body[2])


def test_stamps_must_ascend() -> None:
    with pytest.raises(ValueError, match="ascend"):
        turning([1, 1])
