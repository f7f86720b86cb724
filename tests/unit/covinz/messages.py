"""Hypothesis strategies for every message of `covinz.types`."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from covinz import frames, types

Array = NDArray[Any]
ULID_DIGITS = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
counts = st.integers(0, 2**63 - 1)
small_counts = st.integers(0, 2**32 - 1)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
finite = st.floats(allow_nan=False, allow_infinity=False).map(lambda x: x + 0.0)
durations = st.floats(0, 1e300).map(lambda x: x + 0.0)
codes = st.from_regex(r"[a-z][a-z0-9_]{0,20}", fullmatch=True)
names = st.from_regex(r"[a-zA-Z0-9_.-]{1,20}", fullmatch=True)
hashes = st.text("0123456789abcdef", min_size=16, max_size=16)
job_ids = st.text("0123456789abcdef", min_size=32, max_size=32)
agents = st.from_regex(r"[a-z0-9][a-z0-9_-]{0,31}", fullmatch=True)
ulids = st.builds(
    "{}{}".format, st.sampled_from("01234567"), st.text(ULID_DIGITS, min_size=25, max_size=25)
)
generators = st.integers(0, 2**32).map(np.random.default_rng)
keyframe_ids = st.builds(types.KeyframeId, agents, ulids, counts)
segment_ids = st.builds(types.SegmentId, agents, ulids)


def poses_of(rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
    """Random transforms, many of them close to a quarter or half turn or to none."""
    angle = rng.choice([0.0, 1e-9, np.pi / 2, np.pi, 1.0, 3.0], size=(*shape, 1))
    axis = rng.normal(size=(*shape, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    size = rng.choice([0.0, 1e-6, 1.0, 1e5])
    return frames.transform(frames.so3_exp(angle * axis), size * rng.normal(size=(*shape, 3)))


def _covariance(rng: np.random.Generator) -> Array:
    root = rng.normal(size=(6, 6)) * rng.choice([1e-3, 1.0, 1e3])
    covariance: Array = root @ root.T + 1e-3 * np.trace(root @ root.T) * np.eye(6)
    return (covariance + covariance.T) / 2


def _camera(rng: np.random.Generator, width: int, height: int, model: str) -> types.Camera:
    length = {"PINHOLE": 4, "OPENCV": 8, "FULL_OPENCV": 12, "OPENCV_FISHEYE": 8}[model]
    readout_s = (None, 0.0, rng.uniform())[rng.integers(3)]
    params = rng.uniform(0.1, 1e3, length)
    return types.Camera(model, width, height, params, poses_of(rng), readout_s)


def _twists(rng: np.random.Generator) -> Array:
    twists: Array = rng.uniform(-1e3, 1e3, (2, 6))
    return twists


def _features(rng: np.random.Generator, kind: types.FeatureType, n: int) -> types.Features:
    keypoints: Any = rng.integers(0, 2**16, (n, 2)).astype(np.float32) / 16
    return types.Features(kind, keypoints, rng.integers(0, 256, (n, kind.descriptor_bytes), "u1"))


def _unit(rng: np.random.Generator) -> Array:
    direction = rng.normal(size=3)
    unit: Array = direction / np.linalg.norm(direction)
    return unit


poses = generators.map(poses_of)
covariances = generators.map(_covariance)
sizes = st.integers(1, 4096)
cameras = st.builds(
    _camera,
    generators,
    sizes,
    sizes,
    st.sampled_from(["PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"]),
)
features = st.builds(_features, generators, st.sampled_from(types.FeatureType), st.integers(0, 9))
keyframes = st.builds(
    types.Keyframe,
    keyframe_ids,
    counts,
    poses,
    hashes,
    st.none() | features,
    st.none() | covariances | st.just(np.zeros((6, 6))),
    st.none() | generators.map(_unit),
    st.none() | st.binary(max_size=40),
)
# The same with another kind of feature, where there is room for one.
keyframes = st.builds(
    lambda kf, more: (
        dataclasses.replace(kf, more_features=(more,))
        if kf.features is not None and kf.features.type is not more.type
        else kf
    ),
    keyframes,
    features,
)
gaps = st.tuples(counts, counts).flatmap(
    lambda seqs: st.builds(types.Gap, agents, ulids, st.just(min(seqs)), st.just(max(seqs)), texts)
)
upload_replies = st.one_of(
    st.builds(types.Stored),
    st.builds(types.Duplicate),
    st.builds(types.RetryAfter, durations, texts),
    st.builds(types.NeedCamera, hashes),
    st.builds(types.Rejected, codes, texts),
)


chains = st.just("") | st.text("0123456789abcdef", min_size=32, max_size=32)


@st.composite
def log_pages(draw: st.DrawFn) -> types.LogPage:
    first = draw(st.integers(0, 2**60))
    items = draw(st.lists(keyframes | gaps, max_size=4))
    entries = tuple(types.LogEntry(first + i, item) for i, item in enumerate(items))
    head = first + len(items) + draw(st.integers(0, 2**60))
    return types.LogPage(draw(ulids), head, entries, draw(chains))


rigs = st.lists(
    st.builds(
        types.RigMember,
        keyframe_ids,
        poses,
        hashes,
        st.none() | covariances,
        st.none() | generators.map(_twists),
    ),
    min_size=1,
    max_size=3,
).map(tuple)
loop_jobs = st.builds(types.LoopJob, job_ids, rigs, rigs, finite)
motion_residuals = st.builds(
    types.MotionResidual,
    keyframe_ids,
    keyframe_ids,
    st.lists(finite, min_size=6, max_size=6).map(np.array),
)
solutions = st.builds(types.LoopSolution, poses, covariances, small_counts, finite)
loop_closures = st.builds(
    types.LoopClosure,
    job_ids,
    keyframe_ids,
    keyframe_ids,
    poses,
    covariances,
    small_counts,
    small_counts,
    durations,
    st.lists(motion_residuals, max_size=3).map(tuple),
)
rejections = st.builds(
    types.Rejection,
    job_ids,
    keyframe_ids,
    keyframe_ids,
    codes,
    finite,
    finite,
    texts,
    durations,
    st.lists(solutions, max_size=2).map(tuple),
)
outcomes = loop_closures | rejections
records = st.builds(
    types.JobRecord,
    loop_jobs,
    st.sampled_from(types.JobState),
    small_counts,
    st.none() | outcomes,
)
summaries = st.builds(
    types.MapSummary,
    ulids,
    counts,
    st.lists(segment_ids, min_size=1, max_size=3, unique=True).map(tuple),
    small_counts,
    small_counts,
)


@st.composite
def map_snapshots(draw: st.DrawFn) -> types.MapSnapshot:
    summary, rng = draw(summaries), draw(generators)
    n = draw(st.integers(0, 5))
    m = draw(st.integers(0, 6)) if n else 0
    owners = [summary.segments[i] for i in rng.integers(len(summary.segments), size=n)]
    seqs = [draw(counts) for _ in range(n)]
    return types.MapSnapshot(
        summary=summary,
        keyframes=tuple(
            types.KeyframeId(owner.agent, owner.session, seq)
            for owner, seq in zip(owners, seqs, strict=True)
        ),
        stamps_ns=rng.integers(2**62, size=n),
        T_map_body=poses_of(rng, (n,)),
        T_odom_body=poses_of(rng, (n,)),
        edge_from=rng.integers(max(n, 1), size=m),
        edge_to=rng.integers(max(n, 1), size=m),
        T_from_to=poses_of(rng, (m,)),
        information=np.stack([_covariance(rng) for _ in range(m)]) if m else np.zeros((0, 6, 6)),
        is_loop=rng.integers(2, size=m) > 0,
    )


statuses = st.builds(
    types.Status,
    names,
    names,
    st.just("") | ulids,
    counts,
    counts,
    counts,
    st.booleans(),
    st.dictionaries(texts, finite, max_size=4),
)
messages: st.SearchStrategy[Any] = st.one_of(
    cameras,
    keyframes,
    gaps,
    upload_replies,
    st.builds(types.LogRange, counts, st.sampled_from(types.LogView), st.just("") | ulids, chains),
    log_pages(),
    st.builds(types.LogHead, ulids, counts),
    st.builds(types.LeaseRequest, names),
    st.builds(types.Lease, loop_jobs, names, st.integers(1, 2**32 - 1), durations),
    loop_jobs,
    loop_closures,
    rejections,
    st.builds(types.JobDone, names, outcomes, wants_next=st.booleans()),
    st.builds(types.JobRange, counts),
    st.builds(types.JobPage, counts, counts, st.lists(records, max_size=3).map(tuple)),
    st.builds(types.Correction, keyframe_ids, ulids, counts, poses, st.booleans(), counts),
    st.builds(types.MapList, st.lists(summaries, max_size=3).map(tuple)),
    map_snapshots(),
    statuses,
)
