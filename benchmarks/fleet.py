"""A scenario as the server sees it, in one process: the log of a lockstep run, and its loop jobs.

The player's code reads the robots, every keyframe passes through the wire's coding, and place
recognition makes the jobs; so the jobs, down to their seeds, are those of `covinz run --lockstep`.
"""

from __future__ import annotations

import dataclasses
import tempfile
import threading
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from covinz_agents.player import keyframe_content, lockstep_session
from covinz_agents.source import Frame
from covinz_agents.staging import Part, stage

from covinz import codec, config
from covinz.config import Config
from covinz.evaluation import MAX_GAP_NS, true_loops
from covinz.keyframes import CameraNotFound, KeyframeNotFound
from covinz.scenario import Scenario
from covinz.types import Array, Camera, Keyframe, KeyframeContent, KeyframeId, LogEntry, LoopJob
from services.place_recognition.service import recognizer_factory


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """What the robots of a scenario send, in the order of a lockstep run; a `KeyframeStore`.

    Attributes:
        settings: The scenario's own settings of the server.
        keyframes: By id, in the order of the log.
        cameras: By hash.
        T_world_body: True poses (4, 4) of the keyframes that have any.
        num_bytes: What each robot sends in all.
    """

    settings: Mapping[str, Any]
    keyframes: Mapping[KeyframeId, Keyframe]
    cameras: Mapping[str, Camera]
    T_world_body: Mapping[KeyframeId, Array]
    num_bytes: Mapping[str, int]

    def keyframe(self, keyframe_id: KeyframeId) -> Keyframe:
        """See `KeyframeStore`."""
        try:
            return self.keyframes[keyframe_id]
        except KeyError as error:
            raise KeyframeNotFound(f"no keyframe {keyframe_id}") from error

    def camera(self, camera_hash: str) -> Camera:
        """See `KeyframeStore`."""
        try:
            return self.cameras[camera_hash]
        except KeyError as error:
            raise CameraNotFound(f"no camera {camera_hash}") from error

    def config(self, profile: str) -> Config:
        """The settings of a run of the scenario with this profile."""
        values = config.merge(self.settings, {"loop_solver": {"profile": profile}})
        return config.validate(Config, values, f"a run with profile {profile}")

    def attempts(self, profile: str) -> list[LoopJob]:
        """What place recognition asks to verify in such a run, in its order."""
        recognizer = recognizer_factory(self.config(profile), self.cameras.get)()
        log = (LogEntry(index, kf) for index, kf in enumerate(self.keyframes.values()))
        return [job for entry in log for job in recognizer.process(entry)]

    def true_loop(self, job: LoopJob) -> Array | None:
        """True `T_cand_query` (4, 4) of a job, where both keyframes have ground truth."""
        query, cand = (self.T_world_body.get(keyframe) for keyframe in (job.query, job.cand))
        return None if query is None or cand is None else true_loops(cand, query)


def gather(scenario: Scenario) -> Fleet:
    """Everything that the robots of a scenario send.

    Raises:
        DatasetError, TrajectoryError, ConfigError: If a robot cannot be played.
    """
    with tempfile.TemporaryDirectory() as folder:
        parts = stage(scenario, Path(folder), threading.Event(), lambda done, of: None)
    cameras = {part.source.camera.hash: part.source.camera for part in parts}
    sessions = {
        part.id: lockstep_session(scenario.name, part.id, part.keyframes[0].stamp_ns)
        for part in parts
    }
    keyframes: dict[KeyframeId, Keyframe] = {}
    poses: dict[KeyframeId, Array] = {}
    num_bytes: defaultdict[str, int] = defaultdict(int)
    for part, frame, seq in _turns(parts):
        name = KeyframeId(part.id, sessions[part.id], seq)
        payload = codec.encode(_keyframe(name, keyframe_content(part, frame)))
        num_bytes[part.id] += len(payload)
        keyframes[name] = codec.decode(payload, Keyframe)
        truth = part.source.groundtruth
        T_world_body = truth.at(frame.stamp_ns, MAX_GAP_NS) if truth is not None else None
        if T_world_body is not None:
            poses[name] = T_world_body
    return Fleet(scenario.config, keyframes, cameras, poses, dict(num_bytes))


def by_agent(keyframes: Iterable[KeyframeId]) -> dict[str, list[KeyframeId]]:
    """Each agent's keyframes, in the same order."""
    found: defaultdict[str, list[KeyframeId]] = defaultdict(list)
    for keyframe in keyframes:
        found[keyframe.agent].append(keyframe)
    return dict(found)


def _turns(parts: Sequence[Part]) -> Iterator[tuple[Part, Frame, int]]:
    """All keyframes in stamp order across robots, each with its number in its session."""
    turns = ((part, frame, seq) for part in parts for seq, frame in enumerate(part.keyframes))
    yield from sorted(turns, key=lambda turn: (turn[1].stamp_ns, turn[0].id))


def _keyframe(name: KeyframeId, content: KeyframeContent) -> Keyframe:
    """As an agent makes it of what its front-end measured."""
    measured = {
        field.name: getattr(content, field.name)
        for field in dataclasses.fields(Keyframe)
        if hasattr(content, field.name)
    }
    return Keyframe(id=name, camera_hash=content.camera.hash, **measured)
