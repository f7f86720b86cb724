"""The drill's section of docs/results.md, from its report alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.loop_tables import table

_COLUMNS = (
    "what breaks", "lost", "duplicated", "loops missing / extra / changed", "waiting",
    "well again after", "longest `send`", "",
)  # fmt: skip


def drill_section(report: Mapping[str, Any]) -> str:
    """Every case with what came of it."""
    text = (
        "\n## The fault drill\n\n"
        "`benchmarks/fault_drill.py`, which defines the columns: two robots, four keyframes of"
        " 36 kB a second, and a server with two loop solvers, all real processes on"
        f" {report['cpus']} cores; links have 10 ms round trip, TLS over TCP (cubic) or QUIC."
        " *Waiting* are the keyframes at the robot when the cause ends.\n\n"
    )
    clean = report["case"].get("clean", {})
    rows = [_row(figures) for figures in report["case"].values()]
    return text + table(_COLUMNS, rows) + _summary(report, clean)


def _row(figures: Mapping[str, Any]) -> list[str]:
    title = figures["title"]
    if "skipped" in figures:
        return [title, *["-"] * 6, f"skipped: {figures['skipped']}"]
    failed = "; ".join(figures["failed"])
    if "lost" not in figures:  # it did not come to its end
        return [title, *["-"] * 6, failed]
    loops = [str(figures[f"loops_{what}"]) for what in ("missing", "extra", "changed")]
    recovery_s = figures["recovery_s"]
    return [
        title,
        str(figures["lost"]),
        str(figures["duplicated"]),
        " / ".join(loops),
        "-" if recovery_s is None else str(figures["backlog"]),
        "-" if recovery_s is None else f"{recovery_s:.1f} s",
        f"{figures['send_block_ms_max']:.0f} ms",
        failed,
    ]


def _summary(report: Mapping[str, Any], clean: Mapping[str, Any]) -> str:
    human = report["human_needed"]
    return (
        f"\n{report['cases']} cases, {report['cases_failed']} failed,"
        f" {report['cases_skipped']} skipped, {report['cases_not_played']} of the drill not played"
        f" this time; {report['keyframes_lost_total']} keyframes lost,"
        f" {report['duplicated_total']} duplicated, a human needed in {human}. Undisturbed there"
        f" are {clean.get('loops', '-')} loops.\n"
    )
