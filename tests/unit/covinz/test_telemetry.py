from __future__ import annotations

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz.telemetry import MAX_DURATIONS, Telemetry, quantile


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_counters_add_up_over_threads() -> None:
    telemetry = Telemetry()

    def work() -> None:
        for _ in range(1000):
            telemetry.count("jobs")
        telemetry.count("bytes", 2.5)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert telemetry.snapshot() == {"bytes": 10.0, "jobs": 4000.0}


def test_stages_tell_median_and_p95_in_milliseconds() -> None:
    clock = Clock()
    telemetry = Telemetry(clock)
    for duration_ms in range(1, 102):
        with telemetry.stage("solve"):
            clock.now_s += duration_ms / 1000
    assert telemetry.snapshot() == {
        "solve_ms.median": pytest.approx(51.0),
        "solve_ms.p95": pytest.approx(96.0),
    }


def test_a_stage_that_fails_counts_and_lets_the_error_through() -> None:
    clock = Clock()
    telemetry = Telemetry(clock)
    with pytest.raises(ZeroDivisionError), telemetry.stage("solve"):
        clock.now_s += 0.5
        raise ZeroDivisionError
    assert telemetry.snapshot()["solve_ms.median"] == pytest.approx(500.0)


def test_only_the_last_durations_count() -> None:
    clock = Clock()
    telemetry = Telemetry(clock)
    for duration_s in [100.0] * MAX_DURATIONS + [1.0] * MAX_DURATIONS:
        with telemetry.stage("solve"):
            clock.now_s += duration_s
    assert telemetry.snapshot()["solve_ms.p95"] == pytest.approx(1000.0)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1), st.floats(0, 1), st.floats(0, 1))
def test_quantiles_lie_within_and_grow(values: list[float], p: float, q: float) -> None:
    ordered = sorted(values)
    low, high = quantile(ordered, min(p, q)), quantile(ordered, max(p, q))
    slack = 1e-9 * (1 + abs(ordered[0]) + abs(ordered[-1]))
    assert ordered[0] - slack <= low <= high + slack <= ordered[-1] + 2 * slack
    assert quantile(ordered, 0.0) == ordered[0] and quantile(ordered, 1.0) == ordered[-1]
