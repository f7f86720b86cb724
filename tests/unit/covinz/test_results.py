"""The folder of a finished run."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import covinz.pictures
from covinz import evaluation, report, results
from covinz.candidates import LOOP, read_candidates
from covinz.record import read_plan
from covinz.trajectory import read_tum
from tests.runs import Walks, made_up_run


def test_everything_that_is_named_is_there_and_agrees_with_the_report(tmp_path: Path) -> None:
    record = made_up_run(Walks(agents=2, maps=2, wrong=2))
    made = report.build(record)
    files = results.write(tmp_path, record, made)
    assert all(file.exists() for file in files)
    assert {file.name for file in files} == {file.name for file in tmp_path.iterdir()}
    assert json.loads((tmp_path / "report.json").read_text()) == made
    rows = read_candidates(tmp_path / "candidates.csv")
    assert len(rows) == made["loops"]["candidates"]
    off_m = [float(row.error_m) for row in rows if row.outcome == LOOP]
    assert max(off_m) == pytest.approx(made["loops"]["t_err_max_m"], abs=1e-4)
    for agent in ("agent0", "agent1"):
        for name in ("before", "after"):
            path = read_tum(tmp_path / "trajectories" / f"{agent}.{name}.tum")
            ate_m = evaluation.ate_m(evaluation.associate(path, record.groundtruth[agent]))
            assert ate_m == pytest.approx(made["agents"][agent][f"ate_{name}_m"], abs=1e-3)


def test_without_the_means_to_draw_all_else_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for name in list(sys.modules):
        if name.startswith(covinz.pictures.__name__):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr("covinz.pictures")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    record = made_up_run(Walks(agents=1))
    files = results.write(tmp_path, record, report.build(record))
    assert [file.name for file in files] == [
        *("report.json", "trajectories", "map.g2o", "candidates.csv")
    ]
    assert "covinz[pictures]" in caplog.text


def test_a_plan_is_read_as_the_player_left_it(tmp_path: Path) -> None:
    assert read_plan(tmp_path) == ()
    square = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]
    (tmp_path / "plan.json").write_text(json.dumps({"polygons_m": [square, []]}))
    (outline,) = read_plan(tmp_path)
    assert np.array_equal(outline, square)
