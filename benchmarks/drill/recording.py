"""What the robots of the drill send, made once and kept as a file: no case computes features."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.fleet import gather
from covinz import codec
from covinz.scenario import Scenario
from covinz.types import Camera, Keyframe, KeyframeContent

_SUFFIX = ".keyframes"
_CAMERA = ".camera"
_LENGTH_BYTES = 4


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One robot's keyframes.

    Attributes:
        session: Its session in a lockstep run.
        contents: What it hands over, in order.
    """

    session: str
    contents: tuple[KeyframeContent, ...]


def record(scenario: Scenario, folder: Path) -> Mapping[str, int]:
    """Write the keyframes of all robots of a scenario to a folder; returns how many of each.

    Raises:
        DatasetError, TrajectoryError, ConfigError: If a robot cannot be played.
    """
    fleet = gather(scenario)
    counts: dict[str, int] = {}
    for keyframe in fleet.keyframes.values():
        agent = keyframe.id.agent
        counts[agent] = counts.get(agent, 0) + 1
        payload = codec.encode(keyframe)
        (folder / f"{agent}{_CAMERA}").write_bytes(
            codec.encode(fleet.cameras[keyframe.camera_hash])
        )
        with (folder / f"{agent}{_SUFFIX}").open("ab") as file:
            file.write(len(payload).to_bytes(_LENGTH_BYTES, "little") + payload)
    return counts


def read(folder: Path, agent: str) -> Recording:
    """One robot's part of what `record` wrote."""
    camera = codec.decode((folder / f"{agent}{_CAMERA}").read_bytes(), Camera)
    data = (folder / f"{agent}{_SUFFIX}").read_bytes()
    keyframes = [codec.decode(payload, Keyframe) for payload in _split(data)]
    contents = tuple(_content(keyframe, camera) for keyframe in keyframes)
    return Recording(keyframes[0].id.session, contents)


def _content(keyframe: Keyframe, camera: Camera) -> KeyframeContent:
    assert keyframe.features is not None, "recorded as sent"
    return KeyframeContent(
        keyframe.stamp_ns,
        keyframe.T_odom_body,
        camera,
        keyframe.features,
        keyframe.covariance,
        keyframe.gravity_body,
        more_features=keyframe.more_features,
    )


def _split(data: bytes) -> Iterator[bytes]:
    at = 0
    while at < len(data):
        begin = at + _LENGTH_BYTES
        at = begin + int.from_bytes(data[at:begin], "little")
        yield data[begin:at]
