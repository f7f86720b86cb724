"""Maps as files that other tools read: TUM trajectories and g2o pose graphs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from covinz import g2o
from covinz.trajectory import Trajectory, write_tum
from covinz.types import Array, MapSnapshot


def trajectories(
    snapshots: Sequence[MapSnapshot], *, odometry: bool = False
) -> dict[str, Trajectory]:
    """One trajectory per agent, in stamp order.

    Where an agent has several keyframes of one time (a recording played again, a clock set back)
    the one of its newest session counts, and in a session the last.

    Args:
        snapshots: Maps; an agent's segments may lie in several, then its poses are in the frames
            of those maps.
        odometry: Take the poses as the agent sent them instead of the optimised ones.
    """
    rows: dict[str, list[tuple[int, str, int, Array]]] = defaultdict(list)
    for snapshot in snapshots:
        poses = snapshot.T_odom_body if odometry else snapshot.T_map_body
        for keyframe, stamp, T in zip(snapshot.keyframes, snapshot.stamps_ns, poses, strict=True):
            rows[keyframe.agent].append((int(stamp), keyframe.session, keyframe.seq, T))
    made = {}
    for agent, items in sorted(rows.items()):
        items.sort(key=lambda item: item[:3])
        last = {stamp: T for stamp, _, _, T in items}
        stamps_ns = np.array(list(last), dtype=np.int64)
        made[agent] = Trajectory(stamps_ns, np.stack(list(last.values())))
    return made


def write_maps(folder: Path, snapshots: Sequence[MapSnapshot]) -> list[Path]:
    """Write ``<agent>.tum`` per agent and ``map-<id>.g2o`` per map; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for agent, trajectory in trajectories(snapshots).items():
        files.append(folder / f"{agent}.tum")
        write_tum(files[-1], trajectory)
    for snapshot in snapshots:
        files.append(folder / f"map-{snapshot.summary.map_id}.g2o")
        g2o.write_g2o(files[-1], snapshot)
    return files
