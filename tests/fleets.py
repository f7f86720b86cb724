"""Generated fleets: robots with known poses, noisy odometry and loops of known quality."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from covinz.config import OdometryNoise, OptimizerConfig
from covinz.frames import Array, inverse, rotation_angle, so3_exp, transform
from covinz.types import Keyframe, KeyframeId, LoopClosure, SegmentId
from services.optimizer.components import Component, segment_groups
from services.optimizer.segments import GrowingSegment

LOOP_SIGMAS = np.repeat([0.01, 0.03], 3)


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """Keyframes in log order, loops, and the truth in a common world frame."""

    keyframes: list[Keyframe]
    loops: list[LoopClosure]
    T_world_body: dict[KeyframeId, Array]
    wrong: frozenset[str]


def session(number: int) -> str:
    return f"01J{number:023d}"


def keyframe(agent: str, number: int, seq: int, T_odom_body: Array | None = None) -> Keyframe:
    T = np.eye(4) if T_odom_body is None else T_odom_body
    return Keyframe(KeyframeId(agent, session(number), seq), seq * 10**8, T, "0" * 16, None)


def perturb(rng: np.random.Generator, T: Array, sigmas: Array) -> Array:
    xi = rng.normal(size=6) * sigmas
    return T @ transform(so3_exp(xi[:3]), xi[3:])


def lissajous(phase: float, count: int, step_m: float = 0.5) -> Array:
    """(count, 4, 4) poses on a curve that comes back to its places; x forward."""
    t = phase + np.arange(count) * step_m / 6.0
    p = np.stack([5 * np.sin(t), 4 * np.sin(1.31 * t + 0.4), 0.5 * np.cos(0.7 * t)], axis=1)
    v = np.stack([5 * np.cos(t), 5.24 * np.cos(1.31 * t + 0.4), -0.35 * np.sin(0.7 * t)], axis=1)
    x = v / np.linalg.norm(v, axis=1, keepdims=True)
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return transform(np.stack([x, y, np.cross(x, y)], axis=2), p)


def drifting(rng: np.random.Generator, T_world_body: Array, noise: OdometryNoise) -> Array:
    """Odometry that starts at the identity and drifts as `noise` says."""
    T = [np.eye(4)]
    for step in inverse(T_world_body[:-1]) @ T_world_body[1:]:
        metres, radians = np.linalg.norm(step[:3, 3]), float(rotation_angle(step))
        rotation = np.hypot(
            noise.rotation_per_sqrt_m * np.sqrt(metres),
            noise.rotation_per_sqrt_rad * np.sqrt(radians),
        )
        translation = np.hypot(
            noise.translation_per_sqrt_m * np.sqrt(metres),
            noise.translation_per_sqrt_rad * np.sqrt(radians),
        )
        T.append(T[-1] @ perturb(rng, step, np.repeat([rotation, translation], 3)))
    return np.array(T)


def closure(
    query: KeyframeId, cand: KeyframeId, T_cand_query: Array | None = None, job_id: str = ""
) -> LoopClosure:
    """A loop whose job id, unless given, follows from its keyframes."""
    digest = hashlib.blake2b(f"{query} {cand}".encode(), digest_size=16).hexdigest()
    T = np.eye(4) if T_cand_query is None else T_cand_query
    return LoopClosure(job_id or digest, query, cand, T, np.diag(LOOP_SIGMAS**2), 120, 900, 5.0)


def make_fleet(
    seed: int = 0,
    num_agents: int = 2,
    length: int = 60,
    loops_per_pair: int = 12,
    wrong_share: float = 0.0,
    noise: OdometryNoise | None = None,
) -> Fleet:
    """Robots on one curve, interleaved in the log; loops of every pair, the robot itself included.

    `wrong_share` of each pair's loops have a random relative pose of a few metres.
    """
    rng = np.random.default_rng(seed)
    noise = noise or OptimizerConfig().odometry
    agents = [f"agent{a}" for a in range(num_agents)]
    truth = [lissajous(1.7 * a, length) for a in range(num_agents)]
    odometry = [drifting(rng, T, noise) for T in truth]
    keyframes = [
        keyframe(agents[a], a, k, odometry[a][k]) for k in range(length) for a in range(num_agents)
    ]
    T_world_body = {
        KeyframeId(agents[a], session(a), k): truth[a][k]
        for a in range(num_agents)
        for k in range(length)
    }
    loops, wrong = [], set()
    for a in range(num_agents):
        for b in range(a + 1):
            for number in range(loops_per_pair):
                i = int(rng.integers(length // 2 if a == b else 0, length))
                near = truth[b][: length // 3] if a == b else truth[b]
                distance = np.linalg.norm(near[:, :3, 3] - truth[a][i, :3, 3], axis=1)
                k = int(np.argsort(distance)[rng.integers(min(5, len(near)))])
                T = perturb(rng, inverse(truth[b][k]) @ truth[a][i], LOOP_SIGMAS)
                query = KeyframeId(agents[a], session(a), i)
                cand = KeyframeId(agents[b], session(b), k)
                job_id = rng.bytes(16).hex()
                if number < wrong_share * loops_per_pair:
                    T = perturb(rng, np.eye(4), np.repeat([1.0, 3.0], 3))
                    wrong.add(job_id)
                loops.append(closure(query, cand, T, job_id))
    return Fleet(keyframes, loops, T_world_body, frozenset(wrong))


def components_of(
    keyframes: Iterable[tuple[int, Keyframe]], loops: Iterable[LoopClosure]
) -> list[Component]:
    """What the maps are made of, from keyframes with their log indices and loops."""
    segments: dict[SegmentId, GrowingSegment] = {}
    for index, kf in keyframes:
        segments.setdefault(kf.id.segment, GrowingSegment(kf.id.segment)).add(index, kf)
    first = {name: segment.first_log_index for name, segment in segments.items()}
    return [
        Component(tuple(segments[name].frozen() for name in names), group)
        for names, group in segment_groups(first, loops)
    ]


def only_component(fleet: Fleet) -> Component:
    (component,) = components_of(enumerate(fleet.keyframes), fleet.loops)
    return component


def aligned_rmse(T_map_body: Array, T_world_body: Array) -> float:
    """Position RMSE [m] after the best rigid alignment of both."""
    p, q = T_map_body[:, :3, 3], T_world_body[:, :3, 3]
    p, q = p - p.mean(axis=0), q - q.mean(axis=0)
    U, _, Vt = np.linalg.svd(p.T @ q)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return float(np.sqrt(((p @ R - q) ** 2).sum(axis=1).mean()))
