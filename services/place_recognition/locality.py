"""Which keyframes a worker has had lately: it need not fetch them again for its next job."""

from __future__ import annotations

from collections import OrderedDict

from covinz.types import KeyframeId, LoopJob

# Workers that are remembered.
MAX_WORKERS = 256


class Locality:
    """The keyframes of the jobs that each worker was lent last.

    A guess, good enough for the order of jobs: what a worker has dropped it fetches again.

    Args:
        capacity: Keyframes that a worker keeps.

    Source: decision 0036.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._had: OrderedDict[str, OrderedDict[KeyframeId, None]] = OrderedDict()

    def lent(self, worker: str, job: LoopJob) -> None:
        """A worker gets a job, and has its keyframes from then on."""
        had = self._had.setdefault(worker, OrderedDict())
        self._had.move_to_end(worker)
        for member in (*job.query_rig, *job.cand_rig):
            had[member.keyframe] = None
            had.move_to_end(member.keyframe)
        while len(had) > self._capacity:
            had.popitem(last=False)
        if len(self._had) > MAX_WORKERS:
            self._had.popitem(last=False)

    def gone(self, worker: str) -> None:
        """A worker vanished, and what it had with it."""
        self._had.pop(worker, None)

    def num_known(self, worker: str, job: LoopJob) -> int:
        """How many of a job's keyframes a worker has had lately."""
        had = self._had.get(worker, ())
        return sum(member.keyframe in had for member in (*job.query_rig, *job.cand_rig))
