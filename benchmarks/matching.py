"""Claim: matching two images finds OpenCV's matches many times faster, also without AVX.

Pairs of images of 1,000 descriptors, half of which see the same points: binary ones of 32 bytes
(as ORB) and gradient histograms of 128 bytes (as SIFT). The methods take turns; speed-ups are
medians of the ratios within a turn. Times are CPU times of one thread. `pack` is the preparation
of one image, which serves all pairs that it takes part in.

    python -m benchmarks.matching [--turns N] [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import covinz_core as core
import numpy as np
from numpy.typing import NDArray

_FEATURES = 1000
_IMAGES = 5
_REPEATS = 5
# Flipped bits of two observations of one point; deviation of two observed histograms [units].
_BIT_FLIPS = 0.1
_HISTOGRAM_SIGMA = 6.0
# The largest distances of the public COVINS code for ORB and SIFT.
_MAX_DISTANCE = {"orb": 40.0, "sift": 500.0}

Descriptors = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Descriptors of two images."""

    query: Descriptors
    cand: Descriptors


def orb_pair(rng: np.random.Generator) -> Pair:
    """Binary descriptors; half of the candidates are query descriptors with flipped bits."""
    query = rng.integers(0, 256, (_FEATURES, 32), dtype=np.uint8)
    cand = rng.integers(0, 256, (_FEATURES, 32), dtype=np.uint8)
    flips = np.packbits(rng.random((_FEATURES // 2, 256)) < _BIT_FLIPS, axis=1)
    cand[::2] = query[: _FEATURES // 2] ^ flips
    return Pair(query, cand)


def sift_pair(rng: np.random.Generator) -> Pair:
    """Histograms of norm 512 as OpenCV scales them; half of the candidates are query ones."""

    def scaled(histograms: NDArray[np.float64]) -> NDArray[np.float64]:
        norms: NDArray[np.float64] = np.linalg.norm(histograms, axis=1, keepdims=True)
        return 512 * histograms / norms

    query = scaled(rng.exponential(size=(_FEATURES, 128)))
    cand = scaled(rng.exponential(size=(_FEATURES, 128)))
    cand[::2] = query[: _FEATURES // 2] + rng.normal(0, _HISTOGRAM_SIGMA, (_FEATURES // 2, 128))
    return Pair(*(np.clip(np.rint(d), 0, 255).astype(np.uint8) for d in (query, cand)))


def options(kind: str) -> core.MatchingOptions:
    """Defaults but for the norm and the largest distance."""
    chosen = core.MatchingOptions()
    chosen.norm = core.DescriptorNorm.L2 if kind == "sift" else core.DescriptorNorm.HAMMING
    chosen.max_distance = _MAX_DISTANCE[kind]
    return chosen


def instruction_sets() -> list[core.InstructionSet]:
    """Those that this processor has."""
    return [s for s in core.InstructionSet if core.is_supported(s)]


def methods(pair: Pair, kind: str) -> dict[str, Callable[[], Any]]:
    """What is timed, by name."""
    chosen = options(kind)
    query, cand = core.PackedDescriptors(pair.query), core.PackedDescriptors(pair.cand)
    timed: dict[str, Callable[[], Any]] = {
        "opencv": lambda: core.match_descriptors(pair.query, pair.cand, chosen),
        "pack": lambda: core.PackedDescriptors(pair.query),
    }
    for each in instruction_sets():
        timed[each.name.lower()] = partial(core.match_packed, query, cand, chosen, each)
    return timed


def cpu_ms(run: Callable[[], Any]) -> float:
    """Median of a few runs."""
    times = []
    for _ in range(_REPEATS):
        begin = time.thread_time_ns()
        run()
        times.append(1e-6 * (time.thread_time_ns() - begin))
    return float(np.median(times))


def measure_kind(kind: str, pairs: list[Pair], turns: int) -> dict[str, Any]:
    """Times and speed-ups of one kind of descriptor."""
    times: dict[str, list[float]] = {}
    num_matches = []
    for turn in range(turns):
        timed = methods(pairs[turn % len(pairs)], kind)
        expected = timed["opencv"]()
        num_matches.append(len(expected))
        for name, run in timed.items():
            if name != "pack" and not np.array_equal(run(), expected):
                raise AssertionError(f"{kind}: the matches of {name} differ from those of opencv")
            times.setdefault(name, []).append(cpu_ms(run))
    return {"matches_median": float(np.median(num_matches)), "methods": summary(times)}


def summary(times: Mapping[str, list[float]]) -> dict[str, Any]:
    """Figures of each method."""
    reference = np.array(times["opencv"])
    figures: dict[str, Any] = {}
    for name, values in times.items():
        figures[name] = {
            "ms_median": round(float(np.median(values)), 4),
            "ms_p95": round(float(np.percentile(values, 95)), 4),
        }
        if name not in ("opencv", "pack"):
            figures[name]["speedup_median"] = round(float(np.median(reference / values)), 1)
    return figures


def measure(turns: int) -> dict[str, Any]:
    """All figures of the claim."""
    rng = np.random.default_rng(0)
    makers = {"orb": orb_pair, "sift": sift_pair}
    return {
        "benchmark": "matching",
        "machine": platform.processor() or platform.machine(),
        "isa": core.best_instruction_set().name.lower(),
        "features": _FEATURES,
        "turns": turns,
        "kinds": {
            kind: measure_kind(kind, [make(rng) for _ in range(_IMAGES)], turns)
            for kind, make in makers.items()
        },
    }


def main() -> int:
    """Measure, print and write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--turns", type=int, default=15)
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    report = json.dumps(measure(arguments.turns), indent=2) + "\n"
    sys.stdout.write(report)
    if arguments.out:
        arguments.out.write_text(report)
    return 0


if __name__ == "__main__":
    sys.exit(main())
