"""Jobs of two robots, outcomes of them, and a dispatcher that has such jobs."""

from __future__ import annotations

import numpy as np

from covinz.config import PlaceRecognitionConfig, WorkerConfig
from covinz.types import KeyframeId, LoopClosure, LoopJob, Rejection, RigMember
from services.place_recognition.dispatcher import Dispatcher
from services.place_recognition.journal import Journal

LOG = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
CONFIG = PlaceRecognitionConfig(lease_s=60.0, max_attempts=3, long_poll_s=5.0)


def member(agent: str, seq: int) -> RigMember:
    return RigMember(KeyframeId(agent, LOG, seq), np.eye(4), "0123456789abcdef")


def job(n: int) -> LoopJob:
    query = (member("a", n), member("a", n + 1))
    cand = tuple(member("b", seq) for seq in (n, n + 1, n + 2))
    return LoopJob(f"{n:032x}", query, cand, 1.0)


def rejection(n: int) -> Rejection:
    one = job(n)
    return Rejection(one.id, one.query, one.cand, "pair_inliers", 3.0, 30.0, "", 1.0)


def loop(n: int) -> LoopClosure:
    one = job(n)
    return LoopClosure(one.id, one.query, one.cand, np.eye(4), np.eye(6), 100, 300, 1.0)


def make(journal: Journal, num_jobs: int = 0) -> Dispatcher[str]:
    desk: Dispatcher[str] = Dispatcher(CONFIG, WorkerConfig(), journal)
    desk.reset(LOG)
    for n in range(num_jobs):
        desk.add(job(n))
    return desk
