"""Play seeds: ``python -m tests.simulation --seeds 10000``, or one, told in full: ``--seed 17``."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter

from tests.simulation.plan import Plan, draw_plan
from tests.simulation.simulation import Report, simulate

# Lines of the trace of a single seed.
ALL_LINES = 1_000_000


def main() -> int:
    """0 when everything held in all seeds."""
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--seeds", type=int, default=300, help="how many to play")
    parser.add_argument("--first", type=int, default=0, help="the first of them")
    parser.add_argument("--seed", type=int, help="play this one alone and tell everything")
    parser.add_argument("--shrink", action="store_true", help="leave out what it fails without")
    arguments = parser.parse_args()
    if arguments.seed is None:
        return play_many(range(arguments.first, arguments.first + arguments.seeds))
    plan = draw_plan(arguments.seed)
    report = simulate(plan, trace_lines=ALL_LINES)
    if report.failure is not None and arguments.shrink:
        report = simulate(shrunk(plan), trace_lines=ALL_LINES)
    print(tell(report))
    return int(report.failure is not None)


def play_many(seeds: range) -> int:
    """Play seeds and sum up; the schedule of each that fails is printed."""
    began_s = time.process_time()
    totals: Counter[str] = Counter()
    failed = []
    for seed in seeds:
        report = simulate(draw_plan(seed))
        totals.update(report.counts)
        if report.failure is not None:
            failed.append(seed)
            print(report, flush=True)
    each_s = (time.process_time() - began_s) / max(1, len(seeds))
    print(f"{len(seeds)} seeds, {len(failed)} failed {failed or ''}, {each_s:.3f} s of CPU each")
    print(", ".join(f"{what}: {count}" for what, count in sorted(totals.items())))
    return int(bool(failed))


def shrunk(plan: Plan) -> Plan:
    """The plan without the incidents that its failure does not need."""
    number = 0
    while number < len(plan.incidents):
        less = plan.without(number)
        if simulate(less).failure is not None:
            plan = less
        else:
            number += 1
    return plan


def tell(report: Report) -> str:
    """Everything of one run."""
    verdict = f"FAILED {report.failure}" if report.failure else "everything held"
    summary = f"{report.virtual_s:.3f} s simulated, {report.steps} steps, digest {report.digest}"
    return "\n".join([str(report.plan), *report.trace, summary, verdict])


if __name__ == "__main__":
    sys.exit(main())
