"""Writes the tables of the README from the reports in benchmarks/results.

python -m benchmarks.readme
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.loop_tables import brief

_REPOSITORY = Path(__file__).resolve().parents[1]
_RESULTS = _REPOSITORY / "benchmarks" / "results"
_README = _REPOSITORY / "README.md"
_BEGIN = "<!-- results: written by benchmarks/readme.py -->"
_END = "<!-- end of results -->"
_BEGIN_LOOPS = "<!-- loops: written by benchmarks/readme.py -->"
_END_LOOPS = "<!-- end of loops -->"
_WHAT = {
    "hall": "generated hall, rendered images, three robots",
    "redkitchen": "7-Scenes redkitchen: real images, real RGB-D odometry, three robots",
    "fr1_rpy": "TUM fr1_rpy: two robots that only turn, the degenerate case",
}
_HEADER = (
    "| scenario | keyframes | loops accepted / candidates | wrong | loop error, median"
    " | joint ATE: odometry alone → one map | solver, median / p95 | lost |\n"
    "|---|---|---|---|---|---|---|---|\n"
)


def row(name: str, report: dict[str, Any]) -> str:
    """One line of the table."""
    loops, ms = report["loops"], report["solver_ms"]
    keyframes = sum(agent["keyframes"] for agent in report["agents"].values())
    maps = len(report["maps"])
    error = "-"
    if loops["accepted"]:
        error = f"{loops['t_err_median_m']:.3f} m, {loops['r_err_median_deg']:.2f}°"
    cells = (
        _WHAT[name],
        str(keyframes),
        f"{loops['accepted']} / {loops['candidates']}",
        str(loops["wrong"] or 0),
        error,
        f"{100 * report['joint_ate_before_m']:.1f} → {100 * report['joint_ate_after_m']:.1f} cm"
        + ("" if maps == 1 else f" ({maps} maps)"),
        f"{ms['median']:.0f} / {ms['p95']:.0f} ms",
        str(report["keyframes_lost"]),
    )
    return "| " + " | ".join(cells) + " |\n"


def between(text: str, begin: str, end: str, table: str) -> str:
    """The text with a table in place of what stands between two markers."""
    head, rest = text.split(begin)
    _, tail = rest.split(end)
    return f"{head}{begin}\n{table}{end}{tail}"


def runs() -> str:
    """The table of the runs: the demo as `make demo` plays it, seed 0, and the real images."""
    demo = report("demo")["reports"]
    reports = {"hall": demo["0"], **report("scenarios")["reports"]}
    return _HEADER + "".join(row(name, made) for name, made in reports.items())


def report(name: str) -> dict[str, Any]:
    """The report of a benchmark."""
    made: dict[str, Any] = json.loads((_RESULTS / f"{name}.json").read_text())
    return made


def main() -> None:
    """Replace what stands between the markers; a table whose benchmark was not run stays."""
    text = between(_README.read_text(), _BEGIN, _END, runs())
    if all((_RESULTS / f"{name}.json").exists() for name in ("loop_synthetic", "loop_accuracy")):
        table = brief(report("loop_synthetic"), report("loop_accuracy"))
        text = between(text, _BEGIN_LOOPS, _END_LOOPS, table)
    _README.write_text(text)


if __name__ == "__main__":
    main()
