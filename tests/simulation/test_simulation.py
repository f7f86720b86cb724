"""Some hundreds of seeds; `make simulate SEEDS=10000` plays more. See docs/testing.md."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.simulation.plan import draw_plan
from tests.simulation.sabotage import SABOTAGES
from tests.simulation.simulation import simulate

NUM_SEEDS = 240
SEEDS_PER_TEST = 20
# A defect is found within so many seeds.
MAX_SEEDS_TO_FIND = 60
CHECKOUT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, NUM_SEEDS, SEEDS_PER_TEST))
def test_nothing_is_lost_whatever_happens(first: int) -> None:
    for seed in range(first, first + SEEDS_PER_TEST):
        report = simulate(draw_plan(seed))
        assert report.failure is None, str(report)


def test_one_seed_of_each_kind_of_weather() -> None:
    replies = 0
    for seed in (1, 2, 9):
        report = simulate(draw_plan(seed))
        assert report.failure is None, str(report)
        replies += report.counts["replies"]
    # They did play.
    assert replies > 150


@pytest.mark.slow
@pytest.mark.parametrize("defect", SABOTAGES)
def test_a_defect_is_found(defect: str) -> None:
    assert any(
        simulate(draw_plan(seed), SABOTAGES[defect]()).failure for seed in range(MAX_SEEDS_TO_FIND)
    )


@pytest.mark.slow
def test_a_seed_is_the_same_run_in_every_process() -> None:
    def play(hash_seed: str) -> str:
        return subprocess.run(
            [sys.executable, "-m", "tests.simulation", "--seed", "17"],
            cwd=CHECKOUT,
            env={**os.environ, "PYTHONHASHSEED": hash_seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    assert play("1") == play("2")
