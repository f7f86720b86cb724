from __future__ import annotations

import pytest

from covinz.config import OptimizerConfig
from services.optimizer.pace import Pace


def rest_s(work_s: float, max_share: float = 0.1, max_rest_s: float = 2.0) -> float:
    pace = Pace(OptimizerConfig(max_share=max_share, max_rest_s=max_rest_s))
    pace.begin(100.0)
    pace.end(100.0 + work_s)
    return pace.rests_until_s - (100.0 + work_s)


@pytest.mark.parametrize("max_share", [0.1, 0.25, 1.0])
def test_optimising_takes_its_share(max_share: float) -> None:
    rest = rest_s(0.08, max_share)
    assert 0.08 / (0.08 + rest) == pytest.approx(max_share)


def test_nobody_waits_for_longer_than_the_longest_rest() -> None:
    assert rest_s(30.0) == pytest.approx(2.0)
    assert rest_s(30.0, max_rest_s=0.0) == 0.0


def test_the_first_one_waits_for_nothing() -> None:
    assert Pace(OptimizerConfig()).rests_until_s < 0.0
