"""What the optimizer tells: Correction, MapList, MapSnapshot."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from covinz.codec import poses, values
from covinz.codec.reader import Fields
from covinz.types import Correction, KeyframeId, MapList, MapSnapshot, MapSummary

_UPPER: Final = np.triu_indices(6)


def correction_fields(correction: Correction) -> Fields:
    """Fields of a Correction."""
    return {
        "keyframe": values.keyframe_id_fields(correction.keyframe),
        "map_id": values.ulid(correction.map_id, "map_id"),
        "map_revision": values.whole(correction.map_revision, "map_revision"),
        "pose_map_odom": tuple(poses.pose_values(correction.T_map_odom, "T_map_odom")),
        "jumped": bool(correction.jumped),
        "stamp_ns": values.whole(correction.stamp_ns, "stamp_ns"),
    }


def correction(fields: Fields) -> Correction:
    """The inverse of `correction_fields`."""
    return Correction(
        keyframe=values.keyframe_id(fields["keyframe"]),
        map_id=values.ulid(fields["map_id"], "map_id"),
        map_revision=values.whole(fields["map_revision"], "map_revision"),
        T_map_odom=poses.transforms(fields["pose_map_odom"], "T_map_odom"),
        jumped=fields["jumped"],
        stamp_ns=values.whole(fields["stamp_ns"], "stamp_ns"),
    )


def _summary_fields(summary: MapSummary) -> Fields:
    if not summary.segments:
        raise ValueError("segments: a map has at least one")
    return {
        "map_id": values.ulid(summary.map_id, "map_id"),
        "revision": values.whole(summary.revision, "revision"),
        "segments": [values.segment_id_fields(segment) for segment in summary.segments],
        "num_keyframes": values.whole(summary.num_keyframes, "num_keyframes", 0, values.MAX_COUNT),
        "num_loops": values.whole(summary.num_loops, "num_loops", 0, values.MAX_COUNT),
    }


def _summary(fields: Fields) -> MapSummary:
    if not fields["segments"]:
        raise ValueError("segments: a map has at least one")
    return MapSummary(
        map_id=values.ulid(fields["map_id"], "map_id"),
        revision=values.whole(fields["revision"], "revision"),
        segments=tuple(values.segment_id(segment) for segment in fields["segments"]),
        num_keyframes=fields["num_keyframes"],
        num_loops=fields["num_loops"],
    )


def map_list_fields(maps: MapList) -> Fields:
    """Fields of a MapList."""
    return {"maps": [_summary_fields(summary) for summary in maps.maps]}


def map_list(fields: Fields) -> MapList:
    """The inverse of `map_list_fields`."""
    return MapList(tuple(_summary(summary) for summary in fields["maps"]))


def map_snapshot_fields(snapshot: MapSnapshot) -> Fields:
    """Fields of a MapSnapshot."""
    position = {segment: i for i, segment in enumerate(snapshot.summary.segments)}
    if missing := {kf.segment for kf in snapshot.keyframes} - position.keys():
        raise ValueError(f"keyframes: {min(missing)} is no segment of the map")
    n = len(snapshot.keyframes)
    edges = np.stack([snapshot.edge_from, snapshot.edge_to])
    _check_indices(edges, n, "edges")
    information = _finite(snapshot.information, "information")
    values.check_symmetric(information, "information")
    return {
        "summary": _summary_fields(snapshot.summary),
        "keyframe_segment": np.array([position[kf.segment] for kf in snapshot.keyframes], "u4"),
        "keyframe_seq": np.array(
            [values.whole(kf.seq, "seq") for kf in snapshot.keyframes], dtype="u8"
        ),
        "stamps_ns": _stamps(snapshot.stamps_ns, n),
        "poses_map_body": poses.pose_values(snapshot.T_map_body, "T_map_body"),
        "poses_odom_body": poses.pose_values(snapshot.T_odom_body, "T_odom_body"),
        "edge_from": edges[0].astype("u4"),
        "edge_to": edges[1].astype("u4"),
        "poses_from_to": poses.pose_values(snapshot.T_from_to, "T_from_to"),
        "information": information[:, _UPPER[0], _UPPER[1]],
        "is_loop": snapshot.is_loop,
    }


def map_snapshot(fields: Fields) -> MapSnapshot:
    """The inverse of `map_snapshot_fields`."""
    summary = _summary(fields["summary"])
    seqs, segments = fields["keyframe_seq"], fields["keyframe_segment"]
    n, m = len(seqs), len(fields["edge_from"])
    _check_lengths(fields, n, m)
    _check_indices(segments, len(summary.segments), "keyframe_segment")
    _check_indices(fields["edge_from"], n, "edge_from")
    _check_indices(fields["edge_to"], n, "edge_to")
    owners = [summary.segments[i] for i in segments.tolist()]
    upper = _finite(fields["information"], "information").reshape(m, 21)
    information = np.empty((m, 6, 6))
    information[:, _UPPER[0], _UPPER[1]] = upper
    information[:, _UPPER[1], _UPPER[0]] = upper
    return MapSnapshot(
        summary=summary,
        keyframes=tuple(
            KeyframeId(owner.agent, owner.session, values.whole(seq, "seq"))
            for owner, seq in zip(owners, seqs.tolist(), strict=True)
        ),
        stamps_ns=_stamps(fields["stamps_ns"], n),
        T_map_body=_transforms(fields, "poses_map_body"),
        T_odom_body=_transforms(fields, "poses_odom_body"),
        edge_from=fields["edge_from"].astype(np.int64),
        edge_to=fields["edge_to"].astype(np.int64),
        T_from_to=_transforms(fields, "poses_from_to"),
        information=information,
        is_loop=fields["is_loop"],
    )


def _check_lengths(fields: Fields, n: int, m: int) -> None:
    lengths = {
        "keyframe_segment": n,
        "stamps_ns": n,
        "poses_map_body": 7 * n,
        "poses_odom_body": 7 * n,
        "edge_to": m,
        "poses_from_to": 7 * m,
        "information": 21 * m,
        "is_loop": m,
    }
    for name, length in lengths.items():
        if len(fields[name]) != length:
            raise ValueError(f"{name}: {len(fields[name])} elements instead of {length}")


def _check_indices(indices: NDArray[Any], end: int, name: str) -> None:
    if indices.size and (int(indices.min()) < 0 or int(indices.max()) >= end):
        raise ValueError(f"{name}: an index is not within [0, {end})")


def _stamps(stamps_ns: NDArray[Any], n: int) -> NDArray[Any]:
    if len(stamps_ns) != n or np.any(stamps_ns < 0):
        raise ValueError("stamps_ns: negative, or not one a keyframe")
    return stamps_ns


def _finite(array: NDArray[Any], name: str) -> NDArray[Any]:
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: a number is not finite")
    return array


def _transforms(fields: Fields, name: str) -> NDArray[Any]:
    return poses.transforms(fields[name].reshape(-1, 7), name)
