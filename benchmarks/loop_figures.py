"""What a method made of many loop attempts: counts, errors against the truth, NEES and times."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import covinz_core as core
import numpy as np
from numpy.typing import NDArray

from covinz.evaluation import nees, relative_errors

Array = NDArray[np.float64]

# Of the chi-square distribution with six degrees of freedom.
NEES_LIMIT = 22.5
_MATCHING = "matching"


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A loop of a method that has no covariance to give.

    Attributes:
        T_cand_query: (4, 4).
        stage_ms: Wall times of its stages by name, if it takes them.
    """

    T_cand_query: Array
    stage_ms: Sequence[tuple[str, float]] = ()


@dataclass(frozen=True, slots=True)
class NoPose:
    """Why a method of the benchmarks' own has no loop; `stage` as in the core's rejections."""

    stage: str
    stage_ms: Sequence[tuple[str, float]] = ()


Result = core.LoopEstimate | core.LoopRejection | Pose | NoPose


@dataclass(frozen=True, slots=True)
class Limits:
    """Beyond these a loop is wrong."""

    translation_m: float
    rotation_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Timed:
    """A result and its times.

    Attributes:
        result: Loop or rejection.
        ms: CPU time of the thread.
        stage_ms: Its parts by stage.
    """

    result: Result
    ms: float
    stage_ms: Mapping[str, float]

    @property
    def without_matching_ms(self) -> float:
        """What is left of `ms`."""
        return self.ms - self.stage_ms.get(_MATCHING, 0.0)


def timed(solve: Callable[[], Result]) -> Timed:
    """Solve and take the time."""
    begin = time.thread_time()
    result = solve()
    ms = 1e3 * (time.thread_time() - begin)
    # The core's stages are CPU times already; those of peers are wall times.
    total_ms = sum(stage_ms for _, stage_ms in result.stage_ms)
    share = min(1.0, ms / total_ms) if total_ms > 0 else 1.0
    stages: defaultdict[str, float] = defaultdict(float)
    for name, stage_ms in result.stage_ms:
        stages[name] += share * stage_ms
    return Timed(result, ms, dict(stages))


@dataclass(slots=True)
class Tally:
    """The attempts of one method so far."""

    times_ms: list[float] = field(default_factory=list)
    stages_ms: list[Mapping[str, float]] = field(default_factory=list)
    rejected: Counter[str] = field(default_factory=Counter)
    T_true: list[Array] = field(default_factory=list)
    loops: list[core.LoopEstimate | Pose] = field(default_factory=list)

    def add(self, T_true: Array, attempt: Timed) -> None:
        """One attempt at a loop whose truth is known."""
        self.times_ms.append(attempt.ms)
        self.stages_ms.append(attempt.stage_ms)
        if isinstance(attempt.result, core.LoopRejection | NoPose):
            self.rejected[attempt.result.stage] += 1
            return
        self.T_true.append(T_true)
        self.loops.append(attempt.result)

    @property
    def T_estimate(self) -> Array:
        """(N, 4, 4) of the loops."""
        return np.array([loop.T_cand_query for loop in self.loops]).reshape(-1, 4, 4)

    def wrong(self, limits: Limits) -> NDArray[np.bool_]:
        """(N,) which loops are off by more than the limits."""
        errors = relative_errors(np.array(self.T_true).reshape(-1, 4, 4), self.T_estimate)
        found: NDArray[np.bool_] = (errors.translation_m > limits.translation_m) | (
            errors.rotation_rad > limits.rotation_rad
        )
        return found

    def nees(self, of_truth: Array | None = None, name: str = "covariance") -> Array | None:
        """(N,) NEES of the loops; None where there is no loop or it has no covariance.

        Args:
            of_truth: (6, 6) covariance of the ground truth, added to the loops'.
            name: Which covariance of an estimate to judge.
        """
        covariances = [getattr(loop, name, None) for loop in self.loops]
        if not covariances or any(covariance is None for covariance in covariances):
            return None
        added = np.zeros((6, 6)) if of_truth is None else of_truth
        return nees(np.array(self.T_true), self.T_estimate, np.array(covariances) + added)


def error_figures(tally: Tally) -> dict[str, float | None]:
    """Median and 95 % errors of the loops; None where there is none."""
    names = ("t_err_median_m", "t_err_p95_m", "r_err_median_deg", "r_err_p95_deg")
    if not tally.loops:
        return dict.fromkeys(names)
    errors = relative_errors(np.array(tally.T_true), tally.T_estimate)
    turned_deg = np.rad2deg(errors.rotation_rad)
    values = (
        np.median(errors.translation_m), np.quantile(errors.translation_m, 0.95),
        np.median(turned_deg), np.quantile(turned_deg, 0.95),
    )  # fmt: skip
    return {name: rounded(value) for name, value in zip(names, values, strict=True)}


def nees_figures(values: Array | None) -> dict[str, float | None]:
    """Mean, median and the share beyond the 99.9 % quantile."""
    if values is None:
        return dict.fromkeys(("nees_mean", "nees_median", "nees_over_22_5"))
    return {
        "nees_mean": rounded(values.mean()),
        "nees_median": rounded(np.median(values)),
        "nees_over_22_5": rounded((values > NEES_LIMIT).mean()),
    }


def time_figures(times_ms: Sequence[float]) -> dict[str, float | None]:
    """Median and 95 % quantile."""
    if not times_ms:
        return {"ms_median": None, "ms_p95": None}
    median, p95 = np.quantile(times_ms, [0.5, 0.95])
    return {"ms_median": rounded(median), "ms_p95": rounded(p95)}


def stage_figures(stages_ms: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean time of each stage over all attempts; one that an attempt did not reach counts as 0."""
    names = dict.fromkeys(name for stages in stages_ms for name in stages)
    return {
        name: float(np.round(np.mean([s.get(name, 0.0) for s in stages_ms]), 4)) for name in names
    }


def rounded(value: Any) -> float:
    """Five significant digits: more would only be noise in the files."""
    return float(f"{float(value):.5g}")
