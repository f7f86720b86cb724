"""Claim: on redkitchen the joint ATE is limited by scale, which only the odometry can tell.

Takes the keyframes and loops of a run and optimises the map again with other loops: those between
the same keyframes but exact by ground truth; exact but as long as the odometry would say; with
only the true rotations or only the true translations; as long as a part of the truth. Nothing of
this is used by the system; it tells what the best loops could reach.

    python -m benchmarks.map_floor [--run FOLDER] [--out FILE]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from covinz import codec, evaluation, frames
from covinz.config import OptimizerConfig
from covinz.scenario import groundtruth, load_scenario
from covinz.trajectory import Trajectory
from covinz.types import (
    Array,
    Keyframe,
    KeyframeId,
    LogPage,
    LogRange,
    LogView,
    LoopClosure,
    SegmentId,
)
from services.ingest.log_reader import LogReader
from services.optimizer.components import Component, segment_groups
from services.optimizer.loop_store import LoopStore
from services.optimizer.optimisation import optimise
from services.optimizer.segments import GrowingSegment

_REPOSITORY = Path(__file__).resolve().parents[1]
_SCENARIO = _REPOSITORY / "scenarios" / "redkitchen.yaml"


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Keyframes in log order with their true poses, and the accepted loops of a run."""

    keyframes: Sequence[Keyframe]
    T_world_body: dict[KeyframeId, Array]
    loops: Sequence[LoopClosure]

    def true_loop(self, loop: LoopClosure) -> Array:
        """True ``T_cand_query`` (4, 4)."""
        return evaluation.true_loops(self.T_world_body[loop.cand], self.T_world_body[loop.query])


def read(run: Path) -> Recorded:
    """Read what a finished run left in its folder."""
    reader = LogReader(run / "server" / "ingest.sqlite", page_bytes=1 << 24)
    page = codec.decode(reader.page(LogRange(0, LogView.POSE)), LogPage)
    reader.close()
    keyframes = [entry.item for entry in page.entries if isinstance(entry.item, Keyframe)]
    store = LoopStore(run / "server" / "optimizer.sqlite")
    loops = store.loops()
    store.close()
    scenario = load_scenario(_SCENARIO)
    poses: dict[KeyframeId, Array] = {}
    for agent in scenario.agents:
        truth = groundtruth(scenario, agent.id, run)
        for kf in keyframes:
            T = truth.at(kf.stamp_ns, evaluation.MAX_GAP_NS) if truth else None
            if kf.id.agent == agent.id and T is not None:
                poses[kf.id] = T
    return Recorded(keyframes, poses, loops)


def joint_ate_m(recorded: Recorded, loops: Sequence[LoopClosure]) -> float:
    """Joint ATE of the map that these loops make (they must join all agents)."""
    segments: dict[SegmentId, GrowingSegment] = {}
    for index, kf in enumerate(recorded.keyframes):
        segments.setdefault(kf.id.segment, GrowingSegment(kf.id.segment)).add(index, kf)
    first = {name: segment.first_log_index for name, segment in segments.items()}
    ((members, joined),) = segment_groups(first, loops)
    parts = tuple(segments[name].frozen() for name in members)
    estimate = optimise(Component(parts, joined), OptimizerConfig())
    pairs = []
    for agent in sorted({kf.id.agent for kf in recorded.keyframes}):
        rows = [i for i in range(len(estimate.log_index)) if _agent(recorded, estimate, i) == agent]
        kfs = [recorded.keyframes[int(estimate.log_index[i])] for i in rows]
        stamps = np.array([kf.stamp_ns for kf in kfs])
        truth = np.stack([recorded.T_world_body[kf.id] for kf in kfs])
        pairs.append(
            evaluation.associate(
                Trajectory(stamps, estimate.T_map_body[rows]), Trajectory(stamps, truth)
            )
        )
    return evaluation.joint_ate_m(pairs)


def _agent(recorded: Recorded, estimate: Any, row: int) -> str:
    return recorded.keyframes[int(estimate.log_index[row])].id.agent


def scale_of(T_est: Array, T_true: Array) -> float:
    """Least-squares factor between the translations of relative poses (N, 4, 4)."""
    est, true = T_est[:, :3, 3], T_true[:, :3, 3]
    return float(np.sum(est * true) / np.sum(true * true))


def odometry_scales(recorded: Recorded) -> dict[str, float]:
    """Length of the odometry's steps between keyframes over their true length, by agent."""
    scales = {}
    for agent in sorted({kf.id.agent for kf in recorded.keyframes}):
        kfs = [kf for kf in recorded.keyframes if kf.id.agent == agent]
        T_odom = np.stack([kf.T_odom_body for kf in kfs])
        T_true = np.stack([recorded.T_world_body[kf.id] for kf in kfs])
        scales[agent] = scale_of(
            frames.inverse(T_odom[:-1]) @ T_odom[1:], frames.inverse(T_true[:-1]) @ T_true[1:]
        )
    return scales


def measure(run: Path) -> dict[str, Any]:
    """All figures of one run."""
    recorded = read(run)
    scales = odometry_scales(recorded)

    def ate(change: Callable[[LoopClosure, Array], Array]) -> float:
        changed = [
            dataclasses.replace(loop, T_cand_query=change(loop, recorded.true_loop(loop)))
            for loop in recorded.loops
        ]
        return round(joint_ate_m(recorded, changed), 4)

    def shortened(T: Array, factor: float) -> Array:
        return frames.transform(T[:3, :3], factor * T[:3, 3])

    def odometry_scaled(loop: LoopClosure, T: Array) -> Array:
        return shortened(T, (scales[loop.query.agent] + scales[loop.cand.agent]) / 2)

    T_est = np.stack([loop.T_cand_query for loop in recorded.loops])
    T_true = np.stack([recorded.true_loop(loop) for loop in recorded.loops])
    return {
        "benchmark": "map_floor",
        "loops": len(recorded.loops),
        "odometry_scale": {agent: round(scale, 3) for agent, scale in scales.items()},
        "loop_scale": round(scale_of(T_est, T_true), 3),
        "joint_ate_m": {
            "as accepted": ate(lambda loop, _: loop.T_cand_query),
            "exact": ate(lambda _, T: T),
            "exact, at the odometry's scale": ate(odometry_scaled),
            "exact, 0.9 as long": ate(lambda _, T: shortened(T, 0.9)),
            "exact, 0.8 as long": ate(lambda _, T: shortened(T, 0.8)),
            "true rotation only": ate(
                lambda loop, T: frames.transform(T[:3, :3], loop.T_cand_query[:3, 3])
            ),
            "true translation only": ate(
                lambda loop, T: frames.transform(loop.T_cand_query[:3, :3], T[:3, 3])
            ),
        },
    }


def main() -> None:
    """Measure, print and write JSON; without the recording, say so and do nothing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--run", type=Path, help="folder of a finished run; else one is made")
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    arguments = parser.parse_args()
    if not load_scenario(_SCENARIO).agents[0].path.is_dir():  # type: ignore[union-attr]
        sys.stderr.write("skipped: needs the recording of scenarios/redkitchen.yaml\n")
        return
    with tempfile.TemporaryDirectory() as folder:
        run = arguments.run or Path(folder) / "run"
        if arguments.run is None:
            command = [sys.executable, "-m", "covinz.cli", "run", str(_SCENARIO), "--lockstep"]
            subprocess.run([*command, "--out", str(run)], stdout=sys.stderr, check=True)
        text = json.dumps(measure(run), indent=2) + "\n"
    sys.stdout.write(text)
    if arguments.out:
        arguments.out.write_text(text)


if __name__ == "__main__":
    main()
