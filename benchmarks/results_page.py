"""Writes docs/results.md from the reports in benchmarks/results.

python -m benchmarks.results_page
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.drill.table import drill_section
from benchmarks.loop_tables import accuracy_section, synthetic_section, table, traffic_section
from benchmarks.server_tables import fuzz_section, load_section

REPOSITORY = Path(__file__).resolve().parents[1]
PAGE = REPOSITORY / "docs" / "results.md"
_RESULTS = REPOSITORY / "benchmarks" / "results"
_PICTURES = REPOSITORY / "docs" / "pictures"
# What a scenario is, as the heading of its section.
_WHAT = {
    "hall5": "Five robots in the generated hall",
    "courtyard": "Four robots outdoors, 2.4 km",
    "machine_hall": "Five drones in a machine hall, real odometry",
}
_HEAD = """# Results

Written by `benchmarks/results_page.py` from the reports in `benchmarks/results`; do not edit. Every
scenario is run by `benchmarks/large_scenarios.py` in lockstep with one loop solver, so that its
figures can be had again; times are those of {machine}, two cores, and include what else ran there.
The larger scenarios were run with profile `paper`, when that was the default; `covinz run --profile
paper` does it again.

A loop is wrong when it is off the truth by more than 0.3 m or 8 degrees; it bends the map when it
kept its weight there and its two ends are wrong in the map too. ATE *before* aligns every odometry
on its own; *after* puts one alignment on the whole map, which is harder.

"""
_SUMMARY = (
    "scenario", "robots", "keyframes", "path", "maps", "loops accepted / candidates",
    "wrong (bending)", "loop error, median", "joint ATE before → after", "solver, median / p95",
    "lost",
)  # fmt: skip
# Sections of other benchmarks, in this order.
_SECTIONS = {
    "loop_synthetic": synthetic_section,
    "loop_accuracy": accuracy_section,
    "runtime_traffic": traffic_section,
    "fault_drill": drill_section,
    "load": load_section,
    "fuzz": fuzz_section,
}
_AGENT = ("robot", "keyframes", "path", "ATE before → after", "kB/s")


def page(
    reports: Mapping[str, Mapping[str, Any]],
    machine: str,
    demo: Mapping[str, Any] | None = None,
    others: Mapping[str, Mapping[str, Any]] | None = None,
) -> str:
    """The text of docs/results.md.

    Args:
        reports: `report.json` of every scenario by its name.
        machine: Architecture they ran on.
        demo: What `benchmarks/demo.py` measured, if it was.
        others: What the other benchmarks measured, by their names, those that were run.
    """
    text = _HEAD.format(machine=machine)
    text += table(_SUMMARY, [summary(linked(name), report) for name, report in reports.items()])
    if demo is not None:
        text += demo_section(demo)
    text += "".join(_SECTIONS[name](report) for name, report in (others or {}).items())
    return text + "".join(section(name, report) for name, report in reports.items())


def demo_section(demo: Mapping[str, Any]) -> str:
    """The demo with every seed that was run, and the worst of them."""
    worst = demo["worst"]
    text = "\n## The demo\n\n`scenarios/hall.yaml`, by `benchmarks/demo.py`.\n\n"
    reports = demo["reports"].items()
    text += table(_SUMMARY, [summary(f"seed {seed}", report) for seed, report in reports])
    share = 100 * worst["wrong_share"]
    return text + (
        f"\nThe worst of them: {share:.1f} % wrong loops, {worst['wrong_bending']} of which bend"
        f" the map; joint ATE after {worst['ate_ratio']:.2f} of that before.\n"
    )


def linked(name: str) -> str:
    """A scenario's name as a link to its section."""
    return f"[{name}](#{anchor(name)})"


def summary(first: str, report: Mapping[str, Any]) -> list[str]:
    """A run's line of a table of summaries; `first` names it."""
    loops, ms, agents = report["loops"], report["solver_ms"], report["agents"].values()
    return [
        first,
        str(len(agents)),
        str(sum(agent["keyframes"] for agent in agents)),
        f"{sum(agent['path_m'] for agent in agents):.0f} m",
        str(len(report["maps"])),
        f"{loops['accepted']} / {loops['candidates']}",
        f"{shown(loops['wrong'])} ({shown(loops.get('wrong_bending'))})",
        loop_error(loops),
        ate(report["joint_ate_before_m"], report["joint_ate_after_m"]),
        "-" if ms["median"] is None else f"{ms['median']:.0f} / {ms['p95']:.0f} ms",
        str(report["keyframes_lost"]),
    ]


def section(name: str, report: Mapping[str, Any]) -> str:
    """What a scenario came to, robot by robot, with its picture."""
    loops = report["loops"]
    text = f"\n## {_WHAT.get(name, name)}\n\n`scenarios/{name}.yaml`, run in {phases(report)}.\n\n"
    rows = [
        [agent, str(figures["keyframes"]), f"{figures['path_m']:.0f} m",
         ate(figures["ate_before_m"], figures["ate_after_m"]), f"{figures['kB_per_s']:.0f}"]
        for agent, figures in sorted(report["agents"].items())
    ]  # fmt: skip
    text += table(_AGENT, rows)
    maps = "; ".join(" + ".join(members) for members in report["maps"])
    pairs = ", ".join(f"{pair} {count}" for pair, count in loops["inter_pairs"].items())
    stages = ", ".join(f"{stage} {count}" for stage, count in loops["rejected"].items())
    text += f"\n- Maps: {maps}.\n"
    text += f"- Loops: {loops['intra']} within a robot's path, {loops['inter']} between robots"
    text += f" ({pairs}).\n" if pairs else ".\n"
    text += f"- Candidates rejected, by the stage that did: {stages or 'none'}.\n"
    if loops.get("t_err_max_m") is not None:
        text += (
            f"- Largest error of a loop: {loops['t_err_max_m']:.2f} m,"
            f" {loops['r_err_max_deg']:.1f}°; mean NEES {loops['nees_mean']:.1f}"
            f" (6 would be honest), median {loops['nees_median']:.1f}.\n"
        )
    picture = f"{name}_top_view.png"
    if (_PICTURES / picture).exists():
        text += f"\n![{name} from above, before and after](pictures/{picture})\n"
    return text


def phases(report: Mapping[str, Any]) -> str:
    """How long the run took, by its phases."""
    parts = [f"{what} {lasted_s:.0f} s" for what, lasted_s in report.get("phases_s", {}).items()
             if lasted_s >= 1]  # fmt: skip
    whole = f"{report['wall_s']:.0f} s"
    return f"{whole} ({', '.join(parts)})" if parts else whole


def anchor(name: str) -> str:
    """The fragment that links to a scenario's section."""
    heading = _WHAT.get(name, name).lower()
    return "".join(c for c in heading if c.isalnum() or c in " -").replace(" ", "-")


def ate(before_m: float | None, after_m: float | None) -> str:
    """Two errors in centimetres, or metres where they are large."""
    if before_m is None or after_m is None:
        return "-"
    if before_m >= 1:
        return f"{before_m:.2f} → {after_m:.2f} m"
    return f"{100 * before_m:.1f} → {100 * after_m:.1f} cm"


def loop_error(loops: Mapping[str, Any]) -> str:
    """Median errors of the accepted loops."""
    if loops["t_err_median_m"] is None:
        return "-"
    return f"{100 * loops['t_err_median_m']:.1f} cm, {loops['r_err_median_deg']:.2f}°"


def shown(count: int | None) -> str:
    """A count, if it is known."""
    return "-" if count is None else str(count)


def read() -> str:
    """The page that the results in the repository give."""
    made = json.loads((_RESULTS / "large_scenarios.json").read_text())
    demo = _RESULTS / "demo.json"
    measured = json.loads(demo.read_text()) if demo.exists() else None
    files = {name: _RESULTS / f"{name}.json" for name in _SECTIONS}
    others = {name: json.loads(file.read_text()) for name, file in files.items() if file.exists()}
    return page(made["reports"], made["machine"], measured, others)


def main() -> None:
    """Write the page."""
    PAGE.write_text(read())


if __name__ == "__main__":
    main()
