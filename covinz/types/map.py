"""Maps and corrections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz.types.identity import Array, KeyframeId, SegmentId, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Where a robot's odometry frame is in the shared map.

    Attributes:
        keyframe: The newest optimised keyframe of the segment; the correction is exact there.
        map_id: Session ULID of the map's oldest segment.
        map_revision: Grows with every optimisation of the map.
        T_map_odom: (4, 4), REP-105's map -> odom.
        jumped: The correction moved further than a controller should follow blindly since the
            last one, or names another map.
        stamp_ns: When it was made.
    """

    keyframe: KeyframeId
    map_id: str
    map_revision: int
    T_map_odom: Array
    jumped: bool
    stamp_ns: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_map_odom", frozen_array(self.T_map_odom, (4, 4)))


@dataclass(frozen=True, slots=True)
class MapSummary:
    """One map in a list of maps; `segments` from the oldest on (its odom frame is the map's)."""

    map_id: str
    revision: int
    segments: tuple[SegmentId, ...]
    num_keyframes: int
    num_loops: int


@dataclass(frozen=True, slots=True)
class MapList:
    """All maps, oldest first."""

    maps: tuple[MapSummary, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MapSnapshot:
    """One map as it stands: nodes and edges of its pose graph.

    Attributes:
        summary: Identity and size.
        keyframes: (N) ids in log order.
        stamps_ns: (N,) int64.
        T_map_body: (N, 4, 4) optimised poses.
        T_odom_body: (N, 4, 4) poses as the agents sent them, each in its own odom frame.
        edge_from: (M,) int64 index into keyframes.
        edge_to: (M,) int64 index into keyframes.
        T_from_to: (M, 4, 4) measured relative poses.
        information: (M, 6, 6) of the right perturbation [rotation, translation].
        is_loop: (M,) bool; the others are odometry edges.
    """

    summary: MapSummary
    keyframes: tuple[KeyframeId, ...]
    stamps_ns: NDArray[np.int64]
    T_map_body: Array
    T_odom_body: Array
    edge_from: NDArray[np.int64]
    edge_to: NDArray[np.int64]
    T_from_to: Array
    information: Array
    is_loop: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n, m = len(self.keyframes), len(self.edge_from)
        for name, shape, dtype in (
            ("stamps_ns", (n,), "i8"),
            ("T_map_body", (n, 4, 4), "f8"),
            ("T_odom_body", (n, 4, 4), "f8"),
            ("edge_from", (m,), "i8"),
            ("edge_to", (m,), "i8"),
            ("T_from_to", (m, 4, 4), "f8"),
            ("information", (m, 6, 6), "f8"),
            ("is_loop", (m,), "?"),
        ):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, dtype))
