"""Sections of docs/results.md about the server: load, and decoding of what strangers send."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.loop_tables import table

_PROCESS = ("process", "cores", "CPU per keyframe", "memory")


def load_section(report: Mapping[str, Any]) -> str:
    """Fifty robots, and more workers."""
    text = "\n## Load\n\n`benchmarks/load.py`: recorded keyframes under other names.\n"
    if "uploads" in report:
        text += _uploads(report["uploads"])
    for part, say in (
        ("dispatch", _dispatch),
        ("solving", _solving),
        ("solving_at_once", _solving),
    ):
        if part in report:
            text += say(report[part])
    return text


def _uploads(made: Mapping[str, Any]) -> str:
    """What robots see, and what it takes."""
    lost = made["keyframes_due"] - made["keyframes_accepted"]
    corrected = _spread(made, "keyframe_to_correction", ("p50", "p99"))
    rows = [
        ["keyframes accepted", f"{made['keyframes_per_s']:.0f} /s"],
        ["refused or unanswered", f"{lost} of {made['keyframes_due']}"],
        ["acknowledged after, p50 / p99 / max", _spread(made, "ack")],
        ["in a correction after, p50 / p99", corrected],
        ["looked up by place recognition", f"{made['looked_up_per_s']:.0f} keyframes/s"],
        ["solvers had jobs waiting", f"{100 * made['solving_saturated']:.0f} % of the time"],
        ["cores used by other programs", f"{made['others_cores']:.1f}"],
    ]
    text = (
        f"\n{made['robots']} robots send {made['rate_hz']:g} keyframes/s of"
        f" {made['keyframe_bytes'] / 1e3:.1f} kB for {made['seconds']:.0f} s to a server with"
        f" {made['workers']} loop solvers; they run on the same two cores, which have more to do"
        " than they can. Times count from when a keyframe was due.\n\n"
    )
    text += table(("", ""), rows) + "\n"
    return text + table(
        _PROCESS,
        [
            [name, f"{cores:.2f}", f"{made['cpu_ms_per_keyframe'][name]:.2f} ms",
             f"{made['rss_mib'][name]:.0f} MiB"]
            for name, cores in made["cores"].items()
        ],
    )  # fmt: skip


def _dispatch(made: Mapping[str, Any]) -> str:
    return (
        f"\nDispatching, with a wait of {made['wait_ms']:.0f} ms in place of solving, so that it is"
        f" measured beyond the number of cores: {_rates(made)} (x {made['scaling']:.2f}).\n"
    )


def _solving(made: Mapping[str, Any]) -> str:
    rate_hz = made["rate_hz"]
    how = f"{rate_hz:g} keyframes/s each" if rate_hz else "as fast as they are acknowledged"
    return (
        f"\nReal solving, all processes on two cores, robots that send {how}, from the first"
        f" to the last of {made['jobs']} outcomes, medians of {made['rounds']} rounds:"
        f" {_rates(made)} (x {made['scaling']:.2f}).\n"
    )


def _rates(made: Mapping[str, Any]) -> str:
    """Jobs a second by the number of workers."""
    return ", ".join(
        f"{count} worker{'s' if count != '1' else ''} {rate:.1f} jobs/s"
        for count, rate in made["jobs_per_s"].items()
    )


def _spread(
    made: Mapping[str, Any], name: str, labels: tuple[str, ...] = ("p50", "p99", "max")
) -> str:
    values = [made[f"{name}_{label}_ms"] for label in labels]
    return " / ".join("-" if value is None else f"{value:.0f}" for value in values) + " ms"


def fuzz_section(report: Mapping[str, Any]) -> str:
    """Spoilt messages of every type."""
    totals = report["totals"]
    return (
        "\n## Fuzzing of decoding\n\n"
        f"`benchmarks/fuzz_decoding.py`, {len(report['runs'])} runs: {totals['decodes']:,} messages"
        f" of all {totals['message_types']} types, spoilt, were read by the functions that the"
        f" services call: {totals['refused']:,} refused, {totals['accepted']:,} answered or"
        f" accepted, {totals['findings']} findings (anything but a refusal or a value that can be"
        f" sent on), no crash, no hang. Slowest: {totals['slowest_ms']:.0f} ms of CPU. Memory while"
        f" reading: at most {totals['peak_bytes'] / 1024:.0f} KiB,"
        f" {totals['peak_per_byte']:.0f} times the message where that has a kilobyte or more;"
        f" the process grew by at most {totals['rss_growth_mib']:.1f} MiB in the last nine tenths"
        " of a run. Its corpus is `tests/fuzz/corpus`.\n"
    )
