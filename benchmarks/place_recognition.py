"""Claim: verified votes find the right place more often than tf-idf does, by ORB and by SIFT.

Three agents are disjoint thirds of redkitchen. Every keyframe queries an index of the other
agents' keyframes; it counts if one of these is near by ground truth, and is answered if a near
one is among the first 1 or 5. The vocabularies are the shipped ones, neither trained nor chosen on
this scene. Times are those of an index that generated textures fill up to a given size.

    python -m benchmarks.place_recognition [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import covinz_core as core
import cv2
import numpy as np
from covinz_agents.features import extract
from numpy.typing import NDArray

from covinz import frames
from covinz.config import FeatureConfig, FeatureKind, PlaceRecognitionConfig
from covinz.trajectory import parse_stamp_ns, read_tum, table
from vocabulary.textures import draw_texture

_REPOSITORY = Path(__file__).resolve().parents[1]
_DATA = Path(os.environ.get("COVINZ_DATA", _REPOSITORY.parent / "shared" / "data"))

# Frames of the three agents, and the motion that makes a keyframe, as in scenarios/redkitchen.yaml.
_AGENT_FRAMES = ((0, 332), (334, 666), (668, 998))
_KEYFRAME_M = 0.08
_KEYFRAME_RAD = 0.08
# Two keyframes show the same place when they are so near by ground truth.
_NEAR_M = 0.7
_NEAR_RAD = np.deg2rad(40)
# Textures of the distractors; the vocabulary saw those from seed 0 on.
_FIRST_DISTRACTOR_SEED = 100_000
_MAX_GAP_NS = 100_000_000

Vocabulary = core.Vocabulary | core.ByteVocabulary
Words = NDArray[np.uint32]
Descriptors = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A keyframe: whose it is, where it truly was and what it shows."""

    agent: int
    T_world_cam: NDArray[np.float64]
    words: Words
    descriptors: Descriptors


class Index(Protocol):
    """A way to rank keyframes."""

    def add(self, view: View) -> int:
        """Put a keyframe in and return its slot."""

    def scores(self, view: View) -> NDArray[np.float32]:
        """Score (size,) of every keyframe for a query; higher is more alike."""


class Votes:
    """Verified votes."""

    def __init__(self, index: core.InvertedIndex | core.ResidualIndex) -> None:
        self._index = index

    def add(self, view: View) -> int:
        """Put a keyframe in and return its slot."""
        return self._index.add(view.words, view.descriptors)

    def scores(self, view: View) -> NDArray[np.float32]:
        """Votes (size,) for every keyframe."""
        return self._index.votes(view.words, view.descriptors)


class TfIdf:
    """The paper's score."""

    def __init__(self, vocabulary: Vocabulary) -> None:
        self._index = core.TfIdfIndex(vocabulary)

    def add(self, view: View) -> int:
        """Put a keyframe in and return its slot."""
        return self._index.add(view.words)

    def scores(self, view: View) -> NDArray[np.float32]:
        """Similarity (size,) of the bags of words."""
        return self._index.scores(view.words)


@dataclass(frozen=True, slots=True, eq=False)
class Describer:
    """Describes images by one kind of feature."""

    features: FeatureConfig
    vocabulary: Vocabulary

    def view(self, image: NDArray[np.uint8], agent: int, T_world_cam: NDArray[np.float64]) -> View:
        """The view that an image shows."""
        descriptors = extract(image, self.features).descriptors
        return View(agent, T_world_cam, self.vocabulary.words(descriptors), descriptors)


def read_views(folder: Path, describer: Describer) -> list[View]:
    """Keyframes of the three agents, chosen by the motion of their odometry."""
    truth = read_tum(folder / "groundtruth.tum")
    odometry = read_tum(folder / "odometry.tum")
    views: list[View] = []
    last: dict[int, NDArray[np.float64]] = {}
    for _, (stamp, name) in table(folder / "rgb.txt"):
        frame = int(Path(name).stem)
        agent = next((a for a, (b, e) in enumerate(_AGENT_FRAMES) if b <= frame <= e), None)
        T_world_cam = truth.at(parse_stamp_ns(stamp), _MAX_GAP_NS)
        T_odom_cam = odometry.at(parse_stamp_ns(stamp), _MAX_GAP_NS)
        if agent is None or T_world_cam is None or T_odom_cam is None:
            continue
        if agent in last and not moved(last[agent], T_odom_cam, _KEYFRAME_M, _KEYFRAME_RAD):
            continue
        last[agent] = T_odom_cam
        image = cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)
        views.append(describer.view(np.asarray(image, np.uint8), agent, T_world_cam))
    return views


def moved(T_a: NDArray[np.float64], T_b: NDArray[np.float64], far_m: float, far_rad: float) -> bool:
    """Whether two poses are at least so far apart in translation or in rotation."""
    distance_m = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3]))
    angle_rad = float(frames.rotation_angle(T_a[:3, :3].T @ T_b[:3, :3]))
    return distance_m >= far_m or angle_rad >= far_rad


def recall(views: Sequence[View], new_index: Callable[[], Index]) -> dict[str, float]:
    """Recall at 1 and 5 over the queries that have a near keyframe of another agent."""
    answered: dict[int, list[bool]] = {1: [], 5: []}
    for agent in range(len(_AGENT_FRAMES)):
        others = [view for view in views if view.agent != agent]
        index = new_index()
        for view in others:
            index.add(view)
        for view in (v for v in views if v.agent == agent):
            near = np.array(
                [not moved(view.T_world_cam, o.T_world_cam, _NEAR_M, _NEAR_RAD) for o in others]
            )
            if near.any():
                ranked = near[np.argsort(-index.scores(view), kind="stable")]
                for k, answers in answered.items():
                    answers.append(bool(ranked[:k].any()))
    return {f"recall_at_{k}": float(np.mean(answers)) for k, answers in answered.items()} | {
        "queries": len(answered[1])
    }


def times_ms(
    views: Sequence[View],
    distractors: Sequence[View],
    new_index: Callable[[], Index],
    vocabulary: Vocabulary,
) -> dict[str, float]:
    """Medians: finding the words, inserting and querying with all views in one index."""
    index = new_index()
    inserts = [_time_ms(partial(index.add, view)) for view in [*distractors, *views]]
    queries = [_time_ms(partial(index.scores, view)) for view in views]
    words = [_time_ms(partial(vocabulary.words, view.descriptors)) for view in views]
    return {
        "words_ms": float(np.median(words)),
        "insert_ms": float(np.median(inserts)),
        "query_ms": float(np.median(queries)),
        "keyframes": len(inserts),
    }


def _time_ms(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - start)


def measure(folder: Path, index_size: int) -> dict[str, Any]:
    """All figures of the claim."""
    config = PlaceRecognitionConfig()
    orb = core.Vocabulary.from_bytes((_REPOSITORY / config.vocabulary).read_bytes())
    sift = core.ByteVocabulary.from_bytes((_REPOSITORY / config.sift.vocabulary).read_bytes())
    orb_votes = partial(core.InvertedIndex, config.max_hamming)
    sift_votes = partial(core.ResidualIndex, sift, config.sift.max_hamming)
    of_kind = {
        "orb": _measure_kind("orb", orb, orb_votes, folder, index_size),
        "sift": _measure_kind("sift", sift, sift_votes, folder, index_size),
    }
    return {
        "benchmark": "place_recognition",
        "machine": platform.processor() or platform.machine(),
        **of_kind["orb"],
        "sift": of_kind["sift"],
    }


def _measure_kind(
    kind: FeatureKind,
    vocabulary: Vocabulary,
    new_votes: Callable[[], core.InvertedIndex | core.ResidualIndex],
    folder: Path,
    index_size: int,
) -> dict[str, Any]:
    """The figures by one kind of feature."""
    describer = Describer(FeatureConfig(kinds=(kind,)), vocabulary)
    views = read_views(folder, describer)
    distractors = [
        describer.view(draw_texture(_FIRST_DISTRACTOR_SEED + i), -1, np.eye(4))
        for i in range(max(0, index_size - len(views)))
    ]
    schemes: dict[str, Callable[[], Index]] = {
        "votes": lambda: Votes(new_votes()),
        "tf_idf": lambda: TfIdf(vocabulary),
    }
    results = {
        name: recall(views, new_index) | times_ms(views, distractors, new_index, vocabulary)
        for name, new_index in schemes.items()
    }
    return {
        "vocabulary": vocabulary.hash,
        "views": len(views),
        "schemes": results,
        "votes_over_tf_idf": {
            key: results["votes"][key] / results["tf_idf"][key]
            for key in ("recall_at_1", "recall_at_5", "query_ms")
        },
    }


def main() -> int:
    """Measure, print and write JSON; without the recording, say so and do nothing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=_DATA, help="folder that holds redkitchen/")
    parser.add_argument("--out", type=Path, help="file for the JSON, besides standard output")
    parser.add_argument("--index-size", type=int, default=634, help="keyframes in the timed index")
    arguments = parser.parse_args()
    folder = arguments.data / "redkitchen"
    if not folder.exists():
        print(f"skipped: needs {folder}", file=sys.stderr)
        return 0
    report = json.dumps(measure(folder, arguments.index_size), indent=2)
    print(report)
    if arguments.out:
        arguments.out.write_text(report + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
