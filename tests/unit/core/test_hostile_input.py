"""Numbers and shapes that make no sense raise, whatever they are, and never end the process.

Every argument of every call of the core is spoilt in turn and with the others: not finite, huge,
tiny, of another shape, order or type. What may come out is a result or a plain error.
"""

from __future__ import annotations

import faulthandler
from collections.abc import Callable, Sequence
from typing import Any

import covinz_core as core
import numpy as np
import pytest

from benchmarks.loop_conditions import CONDITIONS
from benchmarks.loop_problems import FOCAL_PX, generate
from tests.unit.core.test_pose_graph import line_graph

# What misuse may raise: nanobind's TypeError where an array cannot be taken at all.
ERRORS = (ValueError, TypeError, OverflowError, IndexError)
# Nothing here takes nearly so long; then the process ends and says where. [s]
HANG_S = 120.0
Rng = np.random.Generator


def spoilt(rng: Rng, value: Any) -> Any:
    """Something in the place of an argument."""
    if isinstance(value, np.ndarray):
        return spoilt_array(rng, value)
    if isinstance(value, list):
        return [value[::-1], value[:1], [], value * 3][rng.integers(4)]
    numbers = [0, -1, 1, 2**31, 2**63, 1e-300, 1e300, float("nan"), float("inf"), None, "x"]
    return numbers[rng.integers(len(numbers))]


@np.errstate(all="ignore")
def spoilt_array(rng: Rng, array: Any) -> Any:
    made: Any = array.copy()
    how = rng.integers(10)
    if how < 4 and made.size:
        at = rng.integers(made.size, size=rng.choice([1, 1, 3, made.size]))
        if made.dtype.kind == "f":
            numbers = [np.nan, np.inf, -np.inf, 0, -1, 1e-300, 1e8, 1e155, 1e300, 5e-324]
        else:
            top = np.iinfo(made.dtype).max if made.dtype.kind in "iu" else 1
            numbers = [0, 1, top, top - 1, top // 2]
        made.flat[at] = made.dtype.type(numbers[rng.integers(len(numbers))])
        return made
    shapes: Sequence[Callable[[], Any]] = (
        lambda: made[:0],
        lambda: made[:1],
        lambda: made[..., : max(1, made.shape[-1] - 1)],
        lambda: made.T,
        lambda: made[None],
        lambda: made.ravel(),
        lambda: np.concatenate([made, made]),
        lambda: made[::-1],
        lambda: made[::2],
        lambda: np.broadcast_to(made.ravel()[:1], made.shape) if made.size else made,
        lambda: made.astype(np.float32),
        lambda: made.astype(np.int32),
        lambda: made.astype(object),
        lambda: np.zeros((0, 0)),
        lambda: -made if made.dtype.kind == "f" else made,
    )
    return shapes[int(rng.integers(len(shapes)))]()


def attack(rng: Rng, call: Callable[..., Any], good: Sequence[Any], times: int) -> int:
    """Call with some arguments spoilt; how often that gave a result."""
    num_results = 0
    for _ in range(times):
        arguments = list(good)
        for i in rng.integers(len(arguments), size=rng.choice([1, 1, 2])):
            arguments[i] = spoilt(rng, arguments[i])
        try:
            call(*arguments)
            num_results += 1
        except ERRORS:
            continue
    return num_results


@pytest.fixture(autouse=True)
def hang_guard() -> Any:
    faulthandler.dump_traceback_later(HANG_S, exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()


@pytest.fixture
def rng() -> Rng:
    return np.random.default_rng(5)


def test_pose_graph(rng: Rng) -> None:
    graph = line_graph()
    good: list[Any] = [graph.T_map_body, np.array([True, False])]
    good += [graph.edge_from, graph.edge_to, graph.T_from_to, graph.information]
    good.append(np.array([False, True]))
    assert core.optimize_pose_graph(*good).converged
    assert attack(rng, core.optimize_pose_graph, good, 3000) > 100


def test_pose_graph_options(rng: Rng) -> None:
    names = [name for name in dir(core.PoseGraphOptions()) if not name.startswith("_")]
    graph = line_graph()

    def optimize(*values: Any) -> None:
        graph.optimize(core.PoseGraphOptions(**dict(zip(names, values, strict=True))))

    good = [getattr(core.PoseGraphOptions(), name) for name in names]
    assert attack(rng, optimize, good, 500) > 10


def test_indices(rng: Rng) -> None:
    words = np.array([3, 1, 1, 0], dtype=np.uint32)
    orb = rng.integers(0, 256, (4, 32), dtype=np.uint8)

    def vote(first: Any, added: Any, then: Any, asked: Any) -> None:
        index = core.InvertedIndex(64)
        index.add(first, added)
        index.add(words, orb)
        assert len(index.votes(then, asked)) == len(index)

    assert attack(rng, vote, [words, orb, words, orb], 2000) > 100


def test_vocabulary(rng: Rng) -> None:
    orb = rng.integers(0, 256, (300, 32), dtype=np.uint8)
    offsets = np.array([0, 100, 300], dtype=np.int64)
    vocabulary = core.Vocabulary.train(orb, offsets, branching=4, depth=2, seed=1)

    def train(*arguments: Any) -> None:
        core.Vocabulary.train(*arguments[:2], branching=arguments[2], depth=arguments[3], seed=1)

    def read(data: Any) -> None:
        assert core.Vocabulary.from_bytes(data).to_bytes() == data

    def score(first: Any, asked: Any) -> None:
        index = core.TfIdfIndex(vocabulary)
        index.add(first)
        index.scores(asked)

    assert attack(rng, train, [orb, offsets, 4, 2], 300) > 10
    assert attack(rng, vocabulary.words, [orb], 300) > 10
    words = vocabulary.words(orb)
    assert attack(rng, score, [words, words], 500) > 10
    whole = vocabulary.to_bytes()
    read(whole)
    for _ in range(500):
        changed = bytearray(whole)
        changed[rng.integers(len(changed))] ^= 1 << rng.integers(8)
        for data in (bytes(changed), whole[: rng.integers(len(whole))], whole + b"\0"):
            with pytest.raises(ValueError):
                read(data)


def solvers() -> dict[str, tuple[Callable[..., Any], list[Any]]]:
    """Each solver as a call with the arrays and numbers that make one of its cameras."""
    problem = generate(CONDITIONS["default"], 0)
    view = problem.cand_views[1]
    pose = problem.T_cand_cam_odometry[1]
    camera = [pose, view.bearings, view.descriptors, FOCAL_PX]
    covariance = np.diag([1e-6] * 3 + [1e-4] * 3)

    def cameras(*spoilt_camera: Any) -> list[Any]:
        return [problem.cand[0], core.RigCamera(*spoilt_camera), problem.cand[2]]

    def paper(*spoilt_camera: Any) -> Any:
        options = core.LoopOptions()
        options.rig.max_num_iterations = 50
        return core.solve_loop(problem.query, cameras(*spoilt_camera), options)

    def fast(first: Any, second: Any, motion: Any, *spoilt_camera: Any) -> Any:
        query = core.LoopRig(problem.query, [core.RigMotion(1, 0, covariance)])
        motions = [core.RigMotion(first, second, motion), core.RigMotion(0, 2, covariance)]
        cand = core.LoopRig(cameras(*spoilt_camera), motions)
        return core.solve_loop_fast(query, cand, core.FastLoopOptions())

    return {"paper": (paper, camera), "fast": (fast, [1, 0, covariance, *camera])}


@pytest.mark.parametrize(("profile", "times"), [("paper", 40), ("fast", 300)])
def test_solvers(rng: Rng, profile: str, times: int) -> None:
    solve, good = solvers()[profile]
    solve(*good)
    assert attack(rng, solve, good, times) > 5
