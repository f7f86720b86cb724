"""Solves a saved job once more: ``python -m services.loop_solver.replay FILE``.

A process of its own, because a job that is worth saving may end it. Prints what came of it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from covinz.saved_job import SavedJobError, read_saved_job
from covinz.types import LoopClosure, Outcome
from services.loop_solver.solver import LoopSolver


def main() -> int:
    """0 when there is an outcome."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    try:
        saved = read_saved_job(parser.parse_args().file)
    except SavedJobError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    job = saved.job
    sys.stdout.write(f"job {job.id}: {job.query} with {job.cand}\n")
    sys.stdout.flush()
    sys.stdout.write(f"{_in_words(LoopSolver(saved.config, saved).solve(job))}\n")
    return 0


def _in_words(outcome: Outcome) -> str:
    if isinstance(outcome, LoopClosure):
        return f"loop closure: {outcome.num_inliers} inliers, {outcome.solver_ms:.1f} ms"
    figures = f"{outcome.count:g} of {outcome.threshold:g} needed, {outcome.solver_ms:.1f} ms"
    return f"rejected at {outcome.stage}: {figures} {outcome.detail}".rstrip()


if __name__ == "__main__":
    sys.exit(main())
