"""The page of results says what the reports in the repository say, and nothing else."""

from __future__ import annotations

import copy
import json
from typing import Any

import pytest

from benchmarks import results_page

RESULTS = results_page.REPOSITORY / "benchmarks" / "results" / "large_scenarios.json"
MADE = json.loads(RESULTS.read_text())


def test_the_page_is_what_the_script_writes() -> None:
    assert results_page.PAGE.read_text() == results_page.read()


def test_every_scenario_has_its_file_its_picture_and_one_map() -> None:
    assert set(MADE["reports"]) == {"hall5", "courtyard", "machine_hall"}
    for name, report in MADE["reports"].items():
        assert (results_page.REPOSITORY / "scenarios" / f"{name}.yaml").exists()
        picture = results_page.REPOSITORY / "docs" / "pictures" / f"{name}_top_view.png"
        assert 0 < picture.stat().st_size < 300_000
        assert report["maps"] == [sorted(report["agents"])]
        assert report["keyframes_lost"] == 0


def of(change: dict[str, Any]) -> str:
    """The page when the first report's loops differ."""
    reports = copy.deepcopy(MADE["reports"])
    next(iter(reports.values()))["loops"].update(change)
    return results_page.page(reports, MADE["machine"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"wrong": 987, "wrong_bending": 654}, "987 (654)"),
        ({"accepted": 4321}, "4321 / "),
        ({"t_err_median_m": 0.1234, "r_err_median_deg": 0.567}, "12.3 cm, 0.57°"),
        ({"t_err_median_m": None}, "| - |"),
    ],
)
def test_figures_come_from_the_reports(change: dict[str, Any], words: str) -> None:
    assert words not in of({})
    assert words in of(change)
