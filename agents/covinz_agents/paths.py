"""True trajectories of rendered robots: walks through free space, given points, recorded flights.

Body: x ahead, z up, as level as a robot that sways a little. World: z up, floor at 0.
"""

from __future__ import annotations

import hashlib
import sys

import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.config import ConfigError
from covinz.scenario import FilePath, RenderedPath, SmoothPath, WaypointPath
from covinz.trajectory import Trajectory, parse_stamp_ns, read_tum
from covinz.types import Array
from covinz_agents.array_cache import cached_array
from covinz_agents.cache_folder import source_digest
from covinz_agents.drift import seed_of
from covinz_agents.wander import Clearance, NoFreePath, free_space, wander
from covinz_agents.world.clearance import clearance_m
from covinz_agents.world.geometry import World
from covinz_agents.world_digest import digest_faces

# Generated paths start at this time. [ns since the Unix epoch]
START_NS = 1_700_000_000_000_000_000
# Sway of the body: roll and pitch [rad], height [m], and their periods [s].
_SWAY = ((0.03, 2.1), (0.04, 3.3), (0.05, 1.7))
_HEAVE_M = _SWAY[2][0]
# Curves are drawn with points so far apart, then sampled. [m]
_DRAWN_M = 0.02
# A walk is smoothed over this length, its gaze over that (standard deviations). [m]
_SMOOTH_M, _SMOOTH_GAZE_M = 0.4, 0.8
# Lengths of the waves by which the height of a walk changes. [m]
_WAVES_M = (7.0, 11.0, 17.0, 29.0)
# Kept from surfaces besides the depth asked for: what smoothing and the grid of the plan cost. [m]
_MARGIN_M = 0.15
# Walks are tried until one keeps its distance.
_MAX_WALKS = 20


def given_positions_m(path: RenderedPath) -> Array:
    """Positions (N, 3) of a path that is given, not made for a world; none of a smooth path."""
    match path:
        case FilePath():
            return np.array(_read(path).T_ref_body[:, :3, 3])
        case WaypointPath():
            return _resampled(_through(path), 0.25)
        case SmoothPath():
            return np.empty((0, 3))


def true_path(
    path: RenderedPath,
    world: World,
    frame_rate_hz: float,
    agent_id: str,
    seed: int = 0,
    max_gap_s: float = 0.2,
) -> Trajectory:
    """True poses ``T_world_body`` of a robot, one for each image.

    Args:
        path: What to follow.
        world: Where; only smooth paths need to know it.
        frame_rate_hz: Images per second.
        agent_id: Robots with the same seed follow different smooth paths.
        seed: The scenario's; added to the path's.
        max_gap_s: A recorded flight is not interpolated over longer gaps.

    Raises:
        NoFreePath: If the world has no such smooth path.
        TrajectoryError: If the file is missing or malformed.
        ConfigError: If no pose of the file is in the range asked for.
    """
    match path:
        case FilePath():
            return _flight(path, frame_rate_hz, round(max_gap_s * 1e9))
        case WaypointPath():
            curve = _through(path)
        case SmoothPath():
            curve = _kept_curve(path, world, seed_of("path", path.seed + seed, agent_id))
    return _along(curve, path, frame_rate_hz)


def _kept_curve(path: SmoothPath, world: World, seed: int) -> Array:
    """The curve of a smooth path: it takes seconds to find, so it is kept between runs."""
    modules = [sys.modules[f.__module__] for f in (smooth_curve, wander, clearance_m)]
    key = hashlib.blake2b(f"{source_digest(modules)} {seed}\n".encode(), digest_size=16)
    key.update(f"{path.length_m} {path.height_m} {path.min_depth_m}\n".encode())
    key.update(f"{world.low_m.tolist()} {world.high_m.tolist()}\n".encode())
    digest_faces(key, world)
    rng = np.random.default_rng(seed)
    found = cached_array("paths", key.hexdigest(), lambda: smooth_curve(path, world, rng))
    return np.asarray(found, dtype=np.float64)


def smooth_curve(path: SmoothPath, world: World, rng: np.random.Generator) -> Array:
    """Points (N, 3), `_DRAWN_M` apart, of a walk that keeps its distance from everything.

    Raises:
        NoFreePath: If none is found.
    """

    def clearance(points_m: Array) -> Array:
        return clearance_m(world, points_m)

    keep_m = path.min_depth_m + _HEAVE_M
    low, high = path.height_m
    space = free_space(clearance, world.low_m, world.high_m, (low, high), keep_m + _MARGIN_M)
    for _ in range(_MAX_WALKS):
        # Smoothing cuts corners: a little more than asked for.
        plan = wander(space, 1.1 * path.length_m + 2.0, rng)
        if plan is None:
            continue
        plane = _resampled(_smoothed(_resampled(plan, _DRAWN_M), _SMOOTH_M / _DRAWN_M), _DRAWN_M)
        height = _height(len(plane), (low, high), rng)
        curve = _resampled(np.concatenate([plane, height[:, None]], axis=1), _DRAWN_M)
        curve = curve[: 1 + round(path.length_m / _DRAWN_M)]
        if _keeps(curve, clearance, keep_m):
            return curve
    raise NoFreePath(
        f"found no path of {path.length_m:g} m at least {path.min_depth_m:g} m from everything"
    )


def _keeps(curve: Array, clearance: Clearance, keep_m: float) -> bool:
    """Whether a curve is nowhere nearer to a surface."""
    return bool(np.all(clearance(curve[:: round(0.1 / _DRAWN_M)]) >= keep_m))


def _height(count: int, band_m: tuple[float, float], rng: np.random.Generator) -> Array:
    """Heights (count,) along a curve: waves that fill a band."""
    along = _DRAWN_M * np.arange(count)
    waves = [length * np.sin(2 * np.pi * (along / length + rng.uniform())) for length in _WAVES_M]
    wave = np.sum(waves, axis=0)
    low, high = wave.min(), wave.max()
    share = (wave - low) / (high - low) if high > low else np.full(count, 0.5)
    return band_m[0] + share * (band_m[1] - band_m[0])


def _through(path: WaypointPath) -> Array:
    """Points (N, 3) of a smooth curve through given points: a cubic spline."""
    points = np.array(path.points_m)
    if path.closed:
        points = np.concatenate([points, points[:1]])
    chord: Array = np.linalg.norm(np.diff(points, axis=0), axis=1)
    tangents = _spline_tangents(points, chord, path.closed)
    pieces = []
    for i, length in enumerate(chord.tolist()):
        t = np.linspace(0.0, 1.0, max(2, round(length / _DRAWN_M)), endpoint=False)[:, None]
        pieces.append(
            (1 + 2 * t) * (1 - t) ** 2 * points[i]
            + t**2 * (3 - 2 * t) * points[i + 1]
            + length * t * (1 - t) ** 2 * tangents[i]
            + length * t**2 * (t - 1) * tangents[i + 1]
        )
    curve = _resampled(np.concatenate([*pieces, points[-1:]]), _DRAWN_M)
    if not path.closed:
        return curve
    lap = curve[:-1]
    count = 1 + round(path.laps * len(lap))
    return lap[np.arange(count) % len(lap)]


def _spline_tangents(points: Array, chord: Array, closed: bool) -> Array:
    """Tangents (N, 3) at points (N, 3) of the cubic spline over chord length.

    Source: de Boor, "A practical guide to splines", 1978, chapter IV: natural ends, or periodic
    where the last point is the first again.
    """
    n = len(points)
    slope = np.diff(points, axis=0) / chord[:, None]
    A, b = np.zeros((n, n)), np.zeros(points.shape)
    for i in range(1, n - 1):
        before, after = 1 / chord[i - 1], 1 / chord[i]
        A[i, i - 1 : i + 2] = [before, 2 * (before + after), after]
        b[i] = 3 * (before * slope[i - 1] + after * slope[i])
    if closed:
        before, after = 1 / chord[-1], 1 / chord[0]
        A[0, [n - 2, 0, 1]] += [before, 2 * (before + after), after]
        b[0] = 3 * (before * slope[-1] + after * slope[0])
        A[-1, [0, -1]] = [1.0, -1.0]
    else:
        A[0, :2], b[0] = [2.0, 1.0], 3 * slope[0]
        A[-1, -2:], b[-1] = [1.0, 2.0], 3 * slope[-1]
    return np.asarray(np.linalg.solve(A, b), dtype=np.float64)


def _along(curve: Array, path: SmoothPath | WaypointPath, frame_rate_hz: float) -> Trajectory:
    """Poses of a robot that follows a curve at constant speed and sways."""
    gaze = _gaze(curve) + path.look_rad
    length_m = _DRAWN_M * (len(curve) - 1)
    count = 1 + int(length_m / path.speed_m_s * frame_rate_hz + 1e-9)
    seconds = np.arange(count) / frame_rate_hz
    at = seconds * path.speed_m_s / _DRAWN_M
    rows = np.arange(len(curve))
    p = np.stack([np.interp(at, rows, curve[:, i]) for i in range(3)], axis=1)
    yaw = np.interp(at, rows, gaze)
    roll, pitch, heave = (size * np.sin(2 * np.pi * seconds / period) for size, period in _SWAY)
    p[:, 2] += heave
    zero = np.zeros(count)
    R = (
        frames.so3_exp(np.stack([zero, zero, yaw], axis=1))
        @ frames.so3_exp(np.stack([zero, pitch, zero], axis=1))
        @ frames.so3_exp(np.stack([roll, zero, zero], axis=1))
    )
    first_ns = START_NS + round(path.start_s * 1e9)
    return Trajectory(first_ns + _ticks_ns(count, frame_rate_hz), frames.transform(R, p))


def _gaze(curve: Array) -> Array:
    """Direction of travel (N,) about the vertical, smooth and without jumps."""
    ahead = np.gradient(curve[:, :2], axis=0) if len(curve) > 1 else np.zeros((1, 2))
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return _smoothed(yaw[:, None], _SMOOTH_GAZE_M / _DRAWN_M)[:, 0]


def _flight(path: FilePath, frame_rate_hz: float, max_gap_ns: int) -> Trajectory:
    """A recorded trajectory at the frame rate, without its gaps."""
    read = _read(path)
    span_ns = int(read.stamps_ns[-1] - read.stamps_ns[0])
    count = 1 + int(span_ns * 1e-9 * frame_rate_hz)
    stamps_ns = read.stamps_ns[0] + _ticks_ns(count, frame_rate_hz)
    poses, found = read.sample(stamps_ns, max_gap_ns)
    return Trajectory(stamps_ns[found], poses)


def _read(path: FilePath) -> Trajectory:
    read = read_tum(path.file)
    keep = np.ones(len(read), dtype=bool)
    if path.times_s is not None:
        first_ns, last_ns = (parse_stamp_ns(text) for text in path.times_s)
        keep = (read.stamps_ns >= first_ns) & (read.stamps_ns <= last_ns)
    if not keep.any():
        raise ConfigError(f"{path.file}: no pose in the range asked for")
    return Trajectory(read.stamps_ns[keep], read.T_ref_body[keep])


def _ticks_ns(count: int, rate_hz: float) -> NDArray[np.int64]:
    """Times (count,) from 0 on at a rate, each rounded to a nanosecond."""
    ticks: NDArray[np.int64] = np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64)
    return ticks


def _resampled(points: Array, step: float) -> Array:
    """Points (M, d) about `step` apart along a polyline (N, d); both ends stay."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    count = 1 + max(1, round(along[-1] / step))
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, column) for column in points.T], axis=1)


def _smoothed(values: Array, sigma: float) -> Array:
    """Values (N, d) under a Gaussian of `sigma` rows; beyond the ends they go on as they end."""
    half = int(np.ceil(3 * sigma))
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / sigma) ** 2)
    weights /= weights.sum()
    # Point reflection about the ends keeps their position and slope.
    index = np.arange(-half, len(values) + half)
    last = len(values) - 1
    inside = values[np.clip(np.where(index < 0, -index, index), 0, last)]
    before = 2 * values[0] - values[np.clip(-index, 0, last)]
    after = 2 * values[-1] - values[np.clip(2 * last - index, 0, last)]
    extended = np.where((index < 0)[:, None], before, inside)
    extended = np.where((index > last)[:, None], after, extended)
    return np.stack([np.convolve(column, weights, "valid") for column in extended.T], axis=1)
