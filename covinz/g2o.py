"""Writes a map as a g2o pose graph: ``VERTEX_SE3:QUAT`` and ``EDGE_SE3:QUAT``.

What a reader of the file must know:

- Vertices have running numbers (g2o's own ids are 32 bits wide, so gtsam's symbol keys would not
  fit); comment lines say which keyframes they are.
- g2o orders the information [translation, rotation] and its rotation error is the vector part of
  a quaternion, half the rotation vector of covinz. Rotation blocks are therefore multiplied by
  four and mixed blocks by two. A tool that takes the numbers for those of rotation vectors
  without converting believes the rotations to be twice as accurate as they are.
- Both use the right perturbation of the measured pose: g2o's translation error is in the frame
  of the measured pose's end, as is covinz's.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import numpy as np

from covinz import frames
from covinz.types import Array, MapSnapshot

_UPPER = np.triu_indices(6)


def write_g2o(path: Path, snapshot: MapSnapshot) -> None:
    """Write the optimised poses and all edges of a map, odometry edges first.

    Vertex i is ``snapshot.keyframes[i]`` at ``T_map_body[i]``.

    Raises:
        OSError: If the file cannot be written.

    Source: Kuemmerle et al., "g2o: A general framework for graph optimization", ICRA 2011, and
    its file format.
    """
    path.write_text("\n".join([*_lines(snapshot), ""]))


def information_to_g2o(information: Array) -> Array:
    """Information (..., 6, 6) of [rotation vector, translation] for g2o's [translation, q_xyz]."""
    scale = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    order = [3, 4, 5, 0, 1, 2]
    scaled: Array = information[..., order, :][..., :, order] * scale[:, None] * scale
    return scaled


def _lines(snapshot: MapSnapshot) -> Iterator[str]:
    yield f"# map {snapshot.summary.map_id}, revision {snapshot.summary.revision}"
    vertices = enumerate(snapshot.keyframes)
    for (segment, _), group in groupby(vertices, key=lambda v: (v[1].segment, v[1].seq - v[0])):
        run = list(group)
        (first, kf), (last, _) = run[0], run[-1]
        yield f"# vertices {first} to {last}: {segment}, keyframes from {kf.seq} on"
    for number, pose in enumerate(frames.pose_from_transform(snapshot.T_map_body)):
        yield f"VERTEX_SE3:QUAT {number} {_numbers(pose)}"
    for is_loop, title in ((False, "odometry"), (True, "loops")):
        edges = np.flatnonzero(snapshot.is_loop == is_loop)
        yield f"# {len(edges)} edges of {title}"
        poses = frames.pose_from_transform(snapshot.T_from_to[edges])
        information = information_to_g2o(snapshot.information[edges])
        for edge, pose, matrix in zip(edges, poses, information, strict=True):
            ends = f"{snapshot.edge_from[edge]} {snapshot.edge_to[edge]}"
            yield f"EDGE_SE3:QUAT {ends} {_numbers(pose)} {_numbers(matrix[_UPPER])}"


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.12g}" for value in values)
