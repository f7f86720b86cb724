"""Writes the results table of the README from demo.json and scenarios.json of benchmarks/results.

python -m benchmarks.readme
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

_REPOSITORY = Path(__file__).resolve().parents[1]
_RESULTS = _REPOSITORY / "benchmarks" / "results"
_README = _REPOSITORY / "README.md"
_BEGIN = "<!-- results: written by benchmarks/readme.py -->"
_END = "<!-- end of results -->"
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


def main() -> None:
    """Replace what stands between the two markers."""
    demo = json.loads((_RESULTS / "demo.json").read_text())["reports"]
    recorded = json.loads((_RESULTS / "scenarios.json").read_text())["reports"]
    # The demo as `make demo` runs it: seed 0.
    reports = {"hall": demo["0"], **recorded}
    table = _HEADER + "".join(row(name, report) for name, report in reports.items())
    text = _README.read_text()
    head, rest = text.split(_BEGIN)
    _, tail = rest.split(_END)
    _README.write_text(f"{head}{_BEGIN}\n{table}{_END}{tail}")


if __name__ == "__main__":
    main()
