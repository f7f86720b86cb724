"""Finished runs made by hand: known truth, drifting odometry, a map and its loops, no server."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.record import RunRecord
from covinz.trajectory import Trajectory
from covinz.types import (
    Array,
    JobRecord,
    JobState,
    KeyframeId,
    LoopClosure,
    LoopJob,
    MapSnapshot,
    MapSummary,
    Rejection,
    RigMember,
    SegmentId,
)

SECOND = 1_000_000_000


@dataclass(frozen=True)
class Walks:
    """What kind of run to make.

    Attributes:
        agents: How many robots.
        keyframes: Of each, one a second.
        size_m: Half the extent of the world.
        climb_m: Half the height of the paths.
        drift: Standard deviation of the odometry's error per keyframe, as a share of the step.
        loops: Pairs of near keyframes that are joined.
        wrong: Of them are off by half the size of the world.
        maps: The robots are split among so many maps.
        truth: Whether ground truth is known.
        plan: Whether the world has a plan.
        seed: Of all random draws.
    """

    agents: int = 3
    keyframes: int = 40
    size_m: float = 8.0
    climb_m: float = 0.2
    drift: float = 0.05
    loops: int = 60
    wrong: int = 0
    maps: int = 1
    truth: bool = True
    plan: bool = False
    seed: int = 1


def made_up_run(walks: Walks) -> RunRecord:
    """A run of robots on ellipses that overlap."""
    rng = np.random.default_rng(walks.seed)
    names = [f"agent{i}" for i in range(walks.agents)]
    truths = {name: _path(i, walks) for i, name in enumerate(names)}
    groups = [names[i :: walks.maps] for i in range(walks.maps)]
    snapshots = [_snapshot(group, truths, walks, rng) for group in groups]
    stamps = np.arange(walks.keyframes) * SECOND
    return RunRecord(
        snapshots,
        [job for snapshot in snapshots for job in _jobs(snapshot)],
        {
            name: {"keyframes": walks.keyframes, "bytes": 10_000, "duration_s": 1.0 * len(stamps)}
            for name in names
        },
        {name: Trajectory(stamps, T) for name, T in truths.items()} if walks.truth else {},
        12.0,
        "made-up",
        _plan(walks) if walks.plan else (),
    )


def _path(number: int, walks: Walks) -> Array:
    """(N, 4, 4) poses on an ellipse of its own, looking ahead."""
    turn = 2 * np.pi * number / walks.agents
    angle = turn + np.linspace(0.0, 2.2 * np.pi, walks.keyframes)
    centre = 0.35 * walks.size_m * np.array([np.cos(turn), 0.6 * np.sin(turn)])
    x = centre[0] + 0.6 * walks.size_m * np.cos(angle)
    y = centre[1] + 0.4 * walks.size_m * np.sin(angle)
    z = 1.5 + walks.climb_m * np.sin(3 * angle)
    turns = np.stack([np.zeros_like(angle), np.zeros_like(angle), angle + np.pi / 2], axis=-1)
    return frames.transform(frames.so3_exp(turns), np.stack([x, y, z], axis=-1))


def _snapshot(
    names: Sequence[str], truths: dict[str, Array], walks: Walks, rng: np.random.Generator
) -> MapSnapshot:
    ids = [
        KeyframeId(name, _session(name), seq) for seq in range(walks.keyframes) for name in names
    ]
    truth = np.stack([truths[found.agent][found.seq] for found in ids])
    odometry = {name: _drifted(truths[name], walks, rng) for name in names}
    noise = frames.transform(
        frames.so3_exp(rng.normal(0, 0.003, (len(ids), 3))),
        rng.normal(0, 0.004 * walks.size_m, (len(ids), 3)),
    )
    T_map_world = frames.transform(frames.so3_exp([0.0, 0.0, 2.0]), [30.0, -4.0, 1.0])
    start, end, T = _loops(ids, truth, walks, rng)
    segments = tuple(SegmentId(name, _session(name)) for name in names)
    return MapSnapshot(
        summary=MapSummary(_session(names[0]), 1, segments, len(ids), len(start)),
        keyframes=tuple(ids),
        stamps_ns=np.array([found.seq * SECOND for found in ids]),
        T_map_body=T_map_world @ truth @ noise,
        T_odom_body=np.stack([odometry[found.agent][found.seq] for found in ids]),
        edge_from=start,
        edge_to=end,
        T_from_to=T,
        information=np.tile(np.eye(6) / (0.02 * walks.size_m) ** 2, (len(start), 1, 1)),
        is_loop=np.ones(len(start), dtype=bool),
    )


def _session(name: str) -> str:
    return f"0{int(name.removeprefix('agent')):025d}"


def _drifted(truth: Array, walks: Walks, rng: np.random.Generator) -> Array:
    """Odometry in a frame of its own that starts at the identity."""
    steps = frames.inverse(truth[:-1]) @ truth[1:]
    length_m = np.linalg.norm(steps[:, :3, 3], axis=1, keepdims=True)
    errors = frames.transform(
        frames.so3_exp(rng.normal(0, walks.drift, (len(steps), 3)) * [0.2, 0.2, 1.0]),
        rng.normal(0, walks.drift, (len(steps), 3)) * length_m,
    )
    poses = [np.eye(4)]
    for step in steps @ errors:
        poses.append(poses[-1] @ step)
    return np.stack(poses)


def _loops(
    ids: Sequence[KeyframeId], truth: Array, walks: Walks, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Candidates, queries (L,) and T_cand_query (L, 4, 4) of near pairs, some of them wrong."""
    places = truth[:, :3, 3]
    distances = np.linalg.norm(places[:, None] - places[None], axis=-1)
    near = [
        (i, j)
        for i, j in np.argwhere(distances < 0.25 * walks.size_m)
        if i < j and (ids[i].agent != ids[j].agent or ids[j].seq - ids[i].seq > walks.keyframes / 2)
    ]
    chosen = rng.choice(len(near), min(walks.loops, len(near)), replace=False)
    pairs = np.array([near[i] for i in sorted(chosen)], dtype=np.int64).reshape(-1, 2)
    start, end = pairs.T
    sigma_m = 0.02 * rng.lognormal(sigma=0.7, size=(len(start), 1))
    errors = frames.transform(np.eye(3), sigma_m * rng.normal(size=(len(start), 3)))
    T = frames.inverse(truth[start]) @ truth[end] @ errors
    T[: walks.wrong, :3, 3] += [0.0, 0.0, 0.5 * walks.size_m]
    return start, end, T


def _jobs(snapshot: MapSnapshot) -> list[JobRecord]:
    """A job for every loop, and one that was rejected for every second loop."""
    jobs = []
    for number, (i, j) in enumerate(zip(snapshot.edge_from, snapshot.edge_to, strict=True)):
        cand, query = snapshot.keyframes[i], snapshot.keyframes[j]
        name = f"{query.agent.removeprefix('agent')}{number:031d}"
        loop = LoopClosure(
            name, query, cand, snapshot.T_from_to[number], np.eye(6) * 0.01, 150, 300, 20.0
        )
        rigs = [(RigMember(kf, np.eye(4), "0" * 16),) for kf in (query, cand)]
        made = LoopJob(name, rigs[0], rigs[1], 42.0)
        jobs.append(JobRecord(made, JobState.DONE, 1, loop))
        if number % 2:
            stage = ("matches", "pair_inliers", "covariance")[number % 3]
            no = Rejection(name, query, cand, stage, 3, 30, "pair 0", 4.0)
            jobs.append(JobRecord(made, JobState.DONE, 1, no))
    return jobs


def _plan(walks: Walks) -> tuple[Array, ...]:
    """Blocks at the corners and in the middle."""
    block = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * 0.12 * walks.size_m
    places = np.array([[-1.0, -0.8], [1.0, -0.8], [1.0, 0.8], [-1.0, 0.8], [0.0, 0.0]])
    return tuple(block + place * walks.size_m for place in places)
