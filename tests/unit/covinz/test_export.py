"""Maps as files: one trajectory per agent, whatever clocks and restarts did to its stamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from covinz import frames
from covinz.export import trajectories, write_maps
from covinz.trajectory import read_tum
from covinz.types import KeyframeId, MapSnapshot, MapSummary, SegmentId

FIRST, SECOND = "01JD0000000000000000000000", "01JD0000000000000000000001"


def snapshot(session: str, stamps: list[int], x_m: list[float]) -> MapSnapshot:
    """A map of one session of agent `a`, without edges."""
    poses = frames.transform(np.eye(3), np.array(x_m)[:, None] * [1.0, 0.0, 0.0])
    none = np.empty(0, dtype=np.int64)
    return MapSnapshot(
        summary=MapSummary(session, 1, (SegmentId("a", session),), len(stamps), 0),
        keyframes=tuple(KeyframeId("a", session, i) for i in range(len(stamps))),
        stamps_ns=np.array(stamps),
        T_map_body=poses,
        T_odom_body=np.eye(4) @ poses,
        edge_from=none,
        edge_to=none,
        T_from_to=np.empty((0, 4, 4)),
        information=np.empty((0, 6, 6)),
        is_loop=np.empty(0, dtype=bool),
    )


def test_trajectories_are_in_stamp_order() -> None:
    maps = [snapshot(SECOND, [30, 40], [3.0, 4.0]), snapshot(FIRST, [10, 20], [1.0, 2.0])]
    path = trajectories(maps)["a"]
    assert path.stamps_ns.tolist() == [10, 20, 30, 40]
    assert path.T_ref_body[:, 0, 3].tolist() == [1.0, 2.0, 3.0, 4.0]


def test_of_keyframes_of_one_time_the_newest_counts() -> None:
    """A recording that is played again, and a clock that was set back within a session."""
    older = snapshot(FIRST, [10, 20, 10], [1.0, 2.0, 1.5])
    newer = snapshot(SECOND, [20, 30], [5.0, 6.0])
    for maps in ([older, newer], [newer, older]):
        path = trajectories(maps)["a"]
        assert path.stamps_ns.tolist() == [10, 20, 30]
        assert path.T_ref_body[:, 0, 3].tolist() == [1.5, 5.0, 6.0]


def test_a_map_becomes_files(tmp_path: Path) -> None:
    files = write_maps(tmp_path / "out", [snapshot(FIRST, [10, 20], [1.0, 2.0])])
    assert [file.name for file in files] == ["a.tum", f"map-{FIRST}.g2o"]
    assert read_tum(files[0]).stamps_ns.tolist() == [10, 20]
