"""Recorded keyframes under other names: few recordings play many robots, at almost no cost.

A recording is encoded once; the names in it are then overwritten in place, so that a robot costs a
copy of 40 kB a keyframe and no encoding. It is played there and back again and so on, so that the
odometry stays in one piece however long it lasts.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.fleet import Fleet, by_agent
from covinz import codec
from covinz.types import Keyframe, KeyframeId

# Names in the recordings that stand nowhere else, and are as long as those that replace them.
_AGENT, _SESSION = "load-0000", "01J" + "Z" * 23
_SEQ, _STAMP_NS = 0x1122334455667788, 0x1234567812345678
# Between the times that two keyframes say they were taken at, however fast they are sent: four a
# second.
_STEP_NS = 250_000_000


def agent_name(number: int) -> str:
    """Robot number so and so."""
    return f"load-{number:04d}"


def session_name(number: int) -> str:
    """The session of a robot."""
    return f"01J{number:023d}"


@dataclass(frozen=True, slots=True)
class Template:
    """An encoded keyframe and where its names stand."""

    payload: bytes
    agent_at: int
    session_at: int
    seq_at: int
    stamp_at: int

    def under(self, name: KeyframeId, stamp_ns: int) -> bytes:
        """The message with another id and time."""
        made = bytearray(self.payload)
        made[self.agent_at : self.agent_at + len(_AGENT)] = name.agent.encode()
        made[self.session_at : self.session_at + len(_SESSION)] = name.session.encode()
        struct.pack_into("<Q", made, self.seq_at, name.seq)
        struct.pack_into("<q", made, self.stamp_at, stamp_ns)
        return bytes(made)


@dataclass(frozen=True, slots=True)
class Recordings:
    """What robots can play.

    Attributes:
        keyframes: Of each recording, in order.
        cameras: Encoded calibrations by hash.
    """

    keyframes: Sequence[Sequence[Template]]
    cameras: Mapping[str, bytes]

    def played(self, number: int, seq: int) -> bytes:
        """The upload of robot `number` at its keyframe `seq`.

        Robots take the recordings in turn, and begin at different places in them.
        """
        frames = self.keyframes[number % len(self.keyframes)]
        cycle = max(1, 2 * len(frames) - 2)
        at = (seq + 37 * number) % cycle
        name = KeyframeId(agent_name(number), session_name(number), seq)
        return frames[min(at, cycle - at)].under(name, (1 + seq) * _STEP_NS)


def write(folder: Path, fleet: Fleet) -> None:
    """Keep what a fleet sends, for the processes that play it."""
    for agent, keyframes in by_agent(fleet.keyframes).items():
        for position, name in enumerate(keyframes):
            anonymous = dataclasses.replace(
                fleet.keyframes[name],
                id=KeyframeId(_AGENT, _SESSION, _SEQ),
                stamp_ns=_STAMP_NS,
            )
            (folder / f"{agent}-{position:05d}.keyframe").write_bytes(codec.encode(anonymous))
    for camera_hash, camera in fleet.cameras.items():
        (folder / f"{camera_hash}.camera").write_bytes(codec.encode(camera))


def read(folder: Path) -> Recordings:
    """What `write` left."""
    recordings: dict[str, list[Template]] = {}
    for file in sorted(folder.glob("*.keyframe")):
        recordings.setdefault(file.stem.rpartition("-")[0], []).append(_template(file.read_bytes()))
    cameras = {file.stem: file.read_bytes() for file in folder.glob("*.camera")}
    return Recordings(list(recordings.values()), cameras)


def _template(payload: bytes) -> Template:
    places = [
        payload.index(mark)
        for mark in (
            _AGENT.encode(),
            _SESSION.encode(),
            struct.pack("<Q", _SEQ),
            struct.pack("<q", _STAMP_NS),
        )
    ]
    made = Template(payload, *places)
    # Only the names may change.
    name = KeyframeId(agent_name(7), session_name(7), 3)
    kf = codec.decode(made.under(name, 5), Keyframe)
    assert (kf.id, kf.stamp_ns) == (name, 5)
    return made
