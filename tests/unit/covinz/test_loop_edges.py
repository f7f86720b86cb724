"""Loops of a map against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from covinz import frames, loop_edges
from covinz.types import KeyframeId, MapSnapshot, MapSummary, SegmentId

SESSION = "0" * 26
SCALE = 2.5


def kf(seq: int) -> KeyframeId:
    return KeyframeId("a", SESSION, seq)


def pose(x: float, yaw_rad: float = 0.0) -> np.ndarray:
    return frames.transform(frames.so3_exp([0.0, 0.0, yaw_rad]), [x, 0.0, 0.0])


def edges_of(loop: np.ndarray, in_map: np.ndarray, sigma: float = 0.1) -> loop_edges.LoopEdges:
    """One loop from keyframe 0 to keyframe 1, which truly is one metre ahead."""
    snapshot = MapSnapshot(
        summary=MapSummary(SESSION, 1, (SegmentId("a", SESSION),), 3, 1),
        keyframes=(kf(0), kf(1), kf(2)),
        stamps_ns=np.arange(3),
        T_map_body=pose(5.0, 1.0) @ np.stack([pose(0.0), in_map, pose(2.0)]),
        T_odom_body=np.stack([pose(0.0), pose(1.0), pose(2.0)]),
        edge_from=np.array([1, 0]),
        edge_to=np.array([2, 1]),
        T_from_to=np.stack([pose(1.0), loop]),
        information=np.tile(np.eye(6) / sigma**2, (2, 1, 1)),
        is_loop=np.array([False, True]),
    )
    truth = {kf(seq): pose(7.0, 2.0) @ pose(float(seq)) for seq in range(3)}
    return loop_edges.loop_edges(snapshot, truth, SCALE)


def test_a_loop_that_the_map_passes_through_has_all_its_weight() -> None:
    edges = edges_of(pose(1.0), pose(1.0))
    assert (edges.cand.tolist(), edges.query.tolist()) == ([0], [1])
    assert edges.weights == pytest.approx([1.0])
    assert edges.translation_m == pytest.approx([0.0], abs=1e-9)
    assert not edges.wrong.any()


def test_a_loop_that_the_map_misses_by_the_scale_has_half_its_weight() -> None:
    # 2.5 sigmas of 0.1 m.
    assert edges_of(pose(1.25), pose(1.0)).weights == pytest.approx([0.5])
    assert edges_of(pose(1.75), pose(1.0)).weights == pytest.approx([0.1])


def test_a_silenced_wrong_loop_is_not_effective() -> None:
    edges = edges_of(pose(3.0), pose(1.0))
    assert edges.translation_m == pytest.approx([2.0])
    assert (edges.wrong[0], edges.effective[0], edges.bending[0]) == (True, False, False)


def test_an_uncertain_wrong_loop_is_effective_but_need_not_bend_the_map() -> None:
    edges = edges_of(pose(1.4), pose(1.1), sigma=0.4)
    assert edges.followed_translation == pytest.approx([0.25])
    assert (edges.wrong[0], edges.effective[0], edges.bending[0]) == (True, True, False)


def test_a_map_that_went_most_of_the_way_to_a_wrong_loop_is_bent() -> None:
    edges = edges_of(pose(1.4), pose(1.3))
    assert edges.followed_translation == pytest.approx([0.75])
    assert edges.bending.tolist() == [True]


def test_turning_counts_where_the_loop_is_wrong_by_turning() -> None:
    loop, in_map = pose(1.0, np.deg2rad(10.0)), pose(1.0, np.deg2rad(6.0))
    edges = edges_of(loop, in_map)
    assert edges.rotation_rad == pytest.approx([np.deg2rad(10.0)])
    assert edges.followed_rotation == pytest.approx([0.6])
    assert edges.bending.tolist() == [True]
    # Wrong by its translation, which the map did not follow: what it turned is no harm of its.
    assert edges_of(pose(1.4, 0.02), pose(1.0, 0.02), sigma=0.4).bending.tolist() == [False]


def test_without_truth_no_loop_is_called_wrong() -> None:
    known = edges_of(pose(9.0), pose(1.0))
    assert known.wrong.tolist() == [True]
    snapshot_only = edges_without_truth()
    assert np.isnan(snapshot_only.translation_m).all()
    assert not snapshot_only.wrong.any()
    assert snapshot_only.weights == pytest.approx([1.0])


def edges_without_truth() -> loop_edges.LoopEdges:
    snapshot = MapSnapshot(
        summary=MapSummary(SESSION, 1, (SegmentId("a", SESSION),), 2, 1),
        keyframes=(kf(0), kf(1)),
        stamps_ns=np.arange(2),
        T_map_body=np.stack([pose(0.0), pose(1.0)]),
        T_odom_body=np.stack([pose(0.0), pose(1.0)]),
        edge_from=np.array([0]),
        edge_to=np.array([1]),
        T_from_to=pose(1.0)[None],
        information=np.eye(6)[None],
        is_loop=np.array([True]),
    )
    return loop_edges.loop_edges(snapshot, {kf(0): pose(0.0)}, SCALE)
