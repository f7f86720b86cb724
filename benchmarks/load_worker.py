"""A loop solver that waits instead of solving: it measures what lends the jobs.

It is the process `services.loop_solver` in everything else: leases, liveliness, outcomes. Every
job is rejected at the stage `waited`, so that nothing of this can pass for a loop.

    python -m benchmarks.load_worker --config FILE --data DIR --id NAME
"""

from __future__ import annotations

import time

from covinz.config import LoopSolverConfig
from covinz.keyframes import KeyframeStore
from covinz.service import Context, serve
from covinz.types import LoopJob, Rejection
from services.loop_solver.service import run

WAIT_S = 0.05


class Waiting:
    """Takes as long as a solver might, and no processor."""

    def __init__(self, config: LoopSolverConfig, store: KeyframeStore) -> None:
        del config, store

    def solve(self, job: LoopJob) -> Rejection:
        """No loop."""
        time.sleep(WAIT_S)
        return Rejection(job.id, job.query, job.cand, "waited", 0.0, 0.0, "", 1e3 * WAIT_S)


def _run(context: Context) -> None:
    run(context, Waiting)


if __name__ == "__main__":
    serve("loop_solver", _run)
