"""Claim: the default scale of the Cauchy loss keeps true loops and survives wrong ones.

Generated fleets with honest loop covariances and odometry edges to four predecessors, whose
weights are shared so that the same motion is not counted ten times. For several scales, shares
of wrong loops and noise levels: error of the optimised map against the truth, in the map frame.

    python -m benchmarks.cauchy_scale [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import covinz_core as core
import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.config import OptimizerConfig

Array = NDArray[np.float64]

_SCALES = (0.5, 1.0, 2.0, 2.5, 3.0, 5.0)
_WRONG_SHARES = (0.0, 0.3, 0.5)
_SEEDS = (0, 1)
_AGENTS = 4
_KEYFRAMES = 120
_LOOPS = 120
# Odometry edges to so many predecessors [paper III-C], whose spans add up to _SPANS.
_NEIGHBOURS = 4
_SPANS = 10
# Wrong loops are off by so much per axis.
_WRONG = (0.3, 1.0)


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations per axis, rotation [rad] and translation [m]."""

    step: tuple[float, float]
    loop: tuple[float, float]


_NOISES = {
    "much drift, loose loops": Noise((0.002, 0.01), (0.01, 0.05)),
    "much drift, tight loops": Noise((0.002, 0.01), (0.004, 0.02)),
    "little drift, loose loops": Noise((0.001, 0.005), (0.01, 0.05)),
}


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """A pose graph whose true poses are known; arrays as optimize_pose_graph takes them."""

    truth: Array
    start: Array
    edge_from: NDArray[np.int64]
    edge_to: NDArray[np.int64]
    T_from_to: Array
    information: Array
    is_loop: NDArray[np.bool_]


def true_poses(agent: int) -> Array:
    """(_KEYFRAMES, 4, 4) of an agent that circles a hall, rising and sinking."""
    t = np.linspace(0, 4.5, _KEYFRAMES)
    around = t + agent
    p = np.stack([12 * np.cos(around) + agent, 12 * np.sin(around), 1.5 * np.sin(3 * t)], axis=1)
    heading = np.stack([0 * t, 0 * t, around + np.pi / 2], axis=1)
    return np.stack(
        [frames.transform(R, x) for R, x in zip(frames.so3_exp(heading), p, strict=True)]
    )


def perturbed(T: Array, sigmas: tuple[float, float], rng: np.random.Generator) -> Array:
    """The pose with right-perturbing noise."""
    R = frames.so3_exp(rng.normal(0, sigmas[0], 3))
    return T @ frames.transform(R, rng.normal(0, sigmas[1], 3))


def information(sigmas: tuple[float, float]) -> Array:
    """(6, 6) inverse covariance of independent axes."""
    return np.diag([sigmas[0] ** -2] * 3 + [sigmas[1] ** -2] * 3)


def make_fleet(noise: Noise, wrong_share: float, seed: int) -> Fleet:
    """Agents with drifting odometry and loops between keyframes that are within 2 m."""
    rng = np.random.Generator(np.random.PCG64(seed))
    truth = np.concatenate([true_poses(agent) for agent in range(_AGENTS)])
    start = truth.copy()
    edges: list[tuple[int, int, Array, Array, bool]] = []
    for first in range(0, len(truth), _KEYFRAMES):
        for i in range(first, first + _KEYFRAMES - 1):
            step = perturbed(frames.inverse(truth[i]) @ truth[i + 1], noise.step, rng)
            start[i + 1] = start[i] @ step
        for i in range(first, first + _KEYFRAMES):
            for span in range(1, min(_NEIGHBOURS, first + _KEYFRAMES - 1 - i) + 1):
                W = information(noise.step) / (span * _SPANS)
                edges.append((i, i + span, frames.inverse(start[i]) @ start[i + span], W, False))
    for number, (cand, query) in enumerate(loop_pairs(truth, rng)):
        T = frames.inverse(truth[cand]) @ truth[query]
        if number < wrong_share * _LOOPS:
            T = perturbed(np.eye(4), _WRONG, rng)
        edges.append((cand, query, perturbed(T, noise.loop, rng), information(noise.loop), True))
    return Fleet(
        truth=truth,
        start=start,
        edge_from=np.array([edge[0] for edge in edges]),
        edge_to=np.array([edge[1] for edge in edges]),
        T_from_to=np.stack([edge[2] for edge in edges]),
        information=np.stack([edge[3] for edge in edges]),
        is_loop=np.array([edge[4] for edge in edges]),
    )


def loop_pairs(truth: Array, rng: np.random.Generator) -> NDArray[np.int64]:
    """(_LOOPS, 2) random pairs of nodes that are near in space and not in time."""
    p = truth[:, :3, 3]
    distance = np.linalg.norm(p[:, None] - p[None], axis=-1)
    cand, query = np.nonzero(np.tril(distance < 2.0, -30))
    chosen = rng.choice(len(cand), _LOOPS, replace=False)
    return np.stack([query[chosen], cand[chosen]], axis=1)


def map_error_m(fleet: Fleet, scale: float) -> float:
    """RMS position error of the map, optimised as the optimizer does it."""
    fixed = np.zeros(len(fleet.start), dtype=bool)
    fixed[0] = True
    result = core.optimize_pose_graph(
        fleet.start,
        fixed,
        fleet.edge_from,
        fleet.edge_to,
        fleet.T_from_to,
        fleet.information,
        fleet.is_loop,
        core.PoseGraphOptions(
            cauchy_scale=scale, cauchy_start_factor=OptimizerConfig().cauchy_start_factor
        ),
    )
    return rms_m(np.asarray(result.T_map_body), fleet.truth)


def rms_m(poses: Array, truth: Array) -> float:
    """RMS distance of positions; the gauge is fixed at the truth, so nothing is aligned."""
    return float(np.sqrt(np.mean(np.sum((poses[:, :3, 3] - truth[:, :3, 3]) ** 2, axis=1))))


def measure() -> dict[str, Any]:
    """Errors by noise, share of wrong loops and scale; means over the seeds."""
    rows: list[dict[str, Any]] = []
    for name, noise in _NOISES.items():
        for share in _WRONG_SHARES:
            fleets = [make_fleet(noise, share, seed) for seed in _SEEDS]
            rows.append(
                {
                    "noise": name,
                    "wrong_loops": share,
                    "before_m": float(np.mean([rms_m(f.start, f.truth) for f in fleets])),
                    "after_m": {
                        str(scale): float(np.mean([map_error_m(f, scale) for f in fleets]))
                        for scale in _SCALES
                    },
                }
            )
    worst = {
        str(scale): max(row["after_m"][str(scale)] / min(row["after_m"].values()) for row in rows)
        for scale in _SCALES
    }
    return {"benchmark": "cauchy_scale", "rows": rows, "worst_ratio_to_best_scale": worst}


def main() -> int:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    report = json.dumps(measure(), indent=2)
    print(report)
    if arguments.out:
        arguments.out.write_text(report + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
