"""A process's status and durations as Prometheus metrics; docs/deployment.md has the table.

What a process counts is in its status, which the `covinz` command shows too; here it gets a name by
Prometheus' conventions, a type and a help text. A number that is not named here is still there, as
``covinz_{service}_{name}``.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from covinz.telemetry import BUCKETS_S, Distribution
from covinz.types import Status


@dataclass(frozen=True, slots=True)
class Described:
    """How one number, or one family of numbers, is called outside.

    Attributes:
        name: Of the metric, without ``covinz_{service}_`` and ``_total``.
        counter: In the status; ``rejected.*`` is a family, of which the rest is the label's value.
        help: What it is, with its unit.
        label: Of a family.
        is_gauge: It may go down.
    """

    name: str
    counter: str
    help: str
    label: str = ""
    is_gauge: bool = False


_CANNOT_STORE = Described(
    "cannot_store", "cannot_store.*", "1 while nothing can be made durable.", "trouble", True
)
METRICS: Mapping[str, tuple[Described, ...]] = {
    "ingest": (
        Described("keyframes", "keyframes.*", "Keyframes in the log.", "agent"),
        Described("bytes", "bytes.*", "Bytes of uploads in the log.", "agent"),
        Described("gaps", "gaps.*", "Declared gaps in the log.", "agent"),
        Described(
            "dropped_keyframes",
            "dropped_keyframes.*",
            "Keyframes that agents declared as lost.",
            "agent",
        ),
        Described("rejected_uploads", "rejected.*", "Uploads refused for good.", "code"),
        Described("duplicates", "duplicates", "Uploads that were in the log already."),
        Described("retries", "retry_after", "Uploads that were told to come again."),
        Described("camera_requests", "need_camera", "Uploads whose calibration was asked for."),
        Described("failed_commits", "failed_commits", "Commits of the log that failed."),
        Described("log_bytes", "log_bytes", "Size of the log on disk.", is_gauge=True),
        Described(
            "entries_without_features",
            "entries_without_features",
            "Entries at the beginning of the log whose features were dropped.",
            is_gauge=True,
        ),
        _CANNOT_STORE,
    ),
    "place_recognition": (
        Described("indexed_keyframes", "indexed", "Keyframes in the index."),
        Described("queries", "queries", "Keyframes that were looked up."),
        Described("unqueried_keyframes", "not_queried", "Keyframes that a guard kept from it."),
        Described("skipped", "skipped.*", "Keyframes or pairs that take no part.", "reason"),
        Described("candidates", "candidates", "Candidates that became jobs."),
        Described("waiting_pairs", "waiting", "Pairs that wait for keyframes.", is_gauge=True),
        Described("accepted_loops", "accepted", "Jobs that became loops.", is_gauge=True),
        Described(
            "rejected_jobs",
            "rejected.*",
            "Jobs that did not, by stage; given up: dead_letter, shed.",
            "stage",
            is_gauge=True,
        ),
        Described("returned_leases", "returned", "Leases that ended without an outcome."),
        Described("duplicate_outcomes", "duplicate_outcomes", "Outcomes that were known."),
        Described("malformed_requests", "malformed", "Requests that could not be read."),
        Described("foreign_outcomes", "outcomes_of_other_logs", "Outcomes of another log."),
        _CANNOT_STORE,
    ),
    "loop_solver": (
        Described("jobs", "jobs", "Jobs done by this process."),
        Described("accepted_loops", "accepted", "Loops that it found."),
        Described("rejected_jobs", "rejected.*", "Jobs without a loop, by stage.", "stage"),
        Described("retries", "resent", "Loops and outcomes that were sent again."),
    ),
    "optimizer": (
        Described("maps", "maps", "Maps.", is_gauge=True),
        Described("keyframes", "keyframes", "Keyframes in all maps.", is_gauge=True),
        Described("loops", "loops", "Loops in all maps.", is_gauge=True),
        Described("gaps", "gaps", "Declared gaps in what was read of the log.", is_gauge=True),
        Described("map_revision", "map_revision", "Revision of the maps.", is_gauge=True),
        Described("optimisations", "optimisations", "Optimisations that ended."),
        Described("outdated_optimisations", "outdated_optimisations", "Those that came too late."),
        Described("unconverged_optimisations", "not_converged", "Those that did not converge."),
        Described(
            "last_optimisation_ms", "last_optimisation_ms", "Time of the last one. [ms]", "", True
        ),
        Described("faulty_loops", "faulty_loops", "Loops left out of the maps.", is_gauge=True),
        Described("rejected_loops", "rejected_loops", "Loops refused."),
        Described(
            "recovered_loops", "recovered_loops", "Loops that came from the journal of jobs."
        ),
        Described("foreign_loops", "loops_of_other_logs", "Loops of another log."),
        Described("jumps", "jumps", "Corrections that moved an agent far."),
        _CANNOT_STORE,
    ),
    "router": (),
}
# Durations: what they are of.
DURATIONS: Mapping[str, str] = {
    "ingest_ack": "From the arrival of an upload to its answer.",
    "loop_solver_solve": "The numeric part of one job.",
    "optimizer_optimisation": "One optimisation of all maps that needed it.",
}
# What every process says of itself, from the status.
COMMON: Mapping[str, str] = {
    "covinz_service_up": "1: the main loop answers.",
    "covinz_service_cursor": "Next index of the log; of ingest: its length.",
    "covinz_service_queue_length": "Uploads, jobs or loops that wait.",
    "covinz_service_leased_jobs": "Jobs lent out; of a loop solver: 1 while it works.",
    "covinz_service_dirty": "1 while something accepted is not in the maps yet.",
}
# Sums of families that the status has for people.
_SUMS = {"ingest": {"keyframes", "bytes", "gaps", "dropped_keyframes"}}


def render(service: str, status: Status | None, distributions: Mapping[str, Distribution]) -> bytes:
    """The text that Prometheus reads: of the service, and memory and CPU of this process.

    Args:
        service: Kind of process.
        status: What its main loop says; None when it does not answer.
        distributions: Of `DURATIONS`.
    """
    registry = CollectorRegistry()
    registry.register(_Collected([*families(service, status), *_durations(distributions)]))
    ProcessCollector(registry=registry)
    return generate_latest(registry)


def families(service: str, status: Status | None) -> Iterator[Metric]:
    """The metrics of a status."""
    values = {"covinz_service_up": float(status is not None)}
    if status is not None:
        values |= {
            "covinz_service_cursor": float(status.cursor),
            "covinz_service_queue_length": float(status.pending),
            "covinz_service_leased_jobs": float(status.leased),
            "covinz_service_dirty": float(status.dirty),
        }
    for name, value in values.items():
        common = GaugeMetricFamily(name, COMMON[name], labels=["service"])
        common.add_metric([service], value)
        yield common
    if status is not None:
        yield from _counted(service, status.counters)


def _counted(service: str, counters: Mapping[str, float]) -> Iterator[Metric]:
    left = {
        name: value for name, value in counters.items() if name not in _SUMS.get(service, set())
    }
    for described in METRICS.get(service, ()):
        kind = GaugeMetricFamily if described.is_gauge else CounterMetricFamily
        labels = [described.label] if described.label else None
        family = kind(f"covinz_{service}_{described.name}", described.help, labels=labels)
        start = described.counter.removesuffix("*")
        for name in [name for name in left if _is_of(name, described.counter)]:
            family.add_metric([name.removeprefix(start)] if labels else [], left.pop(name))
        if family.samples:
            yield family
    for name, value in left.items():
        safe = re.sub(r"\W", "_", name)
        yield GaugeMetricFamily(f"covinz_{service}_{safe}", f"{name} of the status.", value=value)


def _is_of(name: str, counter: str) -> bool:
    return name.startswith(counter[:-1]) if counter.endswith("*") else name == counter


def _durations(distributions: Mapping[str, Distribution]) -> Iterator[Metric]:
    for name, found in distributions.items():
        family = HistogramMetricFamily(f"covinz_{name}_seconds", DURATIONS.get(name, name))
        ends = [*(str(end_s) for end_s in BUCKETS_S), "+Inf"]
        buckets = list(zip(ends, map(float, accumulate(found.counts)), strict=True))
        family.add_metric([], buckets=buckets, sum_value=found.sum_s)
        yield family


class _Collected(Collector):
    """What was collected already."""

    def __init__(self, metrics: list[Metric]) -> None:
        self._metrics = metrics

    def collect(self) -> list[Metric]:
        return self._metrics


def table() -> str:
    """All metrics as the Markdown table of docs/deployment.md; ``python -m covinz.metrics``."""
    rows = [(name, "gauge", text) for name, text in COMMON.items()]
    for service, described in METRICS.items():
        for one in described:
            end, kind = ("", "gauge") if one.is_gauge else ("_total", "counter")
            label = f"{{{one.label}}}" if one.label else ""
            rows.append((f"covinz_{service}_{one.name}{end}{label}", kind, one.help))
    rows += [(f"covinz_{name}_seconds", "histogram", text) for name, text in DURATIONS.items()]
    lines = ["| metric | type | what |", "|---|---|---|"]
    return "\n".join([*lines, *(f"| `{name}` | {kind} | {text} |" for name, kind, text in rows)])


if __name__ == "__main__":
    sys.stdout.write(f"{table()}\n")
