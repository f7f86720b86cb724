"""What `covinz run` says at its end: a table of the robots, a line for each figure, where to look.

Fits 80 columns; without colours it loses nothing.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

_ARROW = "\N{RIGHTWARDS ARROW}"
# What is said of the files of a run that are worth opening first.
_FILES = {
    "top_view.png": "odometry alone and the map, from above",
    "map_3d.png": "the same in space",
    "error_over_time.png": "how far off each robot is, and when",
    "loops.png": "what became of the candidates",
    "report.json": "all figures",
    "candidates.csv": "every candidate: loop, or why not",
    "trajectories": "TUM files, before and after",
    "map.g2o": "the pose graph",
}


def show(console: Console, made: Mapping[str, Any], folder: Path, files: Sequence[Path]) -> None:
    """Print the summary of a run.

    Args:
        console: Where to.
        made: The report.
        folder: The run's folder.
        files: What is in it to look at.
    """
    console.print()
    console.print(Text(_headline(made), style="bold"))
    console.print(_agents(made))
    console.print()
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="cyan", no_wrap=True)
    facts.add_column(overflow="fold")
    for name, text in _facts(made):
        facts.add_row(name, text)
    console.print(facts)
    console.print()
    console.print(_where_to_look(folder, files))
    ask = f"covinz why {next(iter(made['agents']), 'ROBOT')}/0 --run {_shown(folder)}"
    console.print()
    # A line that is wrapped could not be copied.
    console.print(Text(f"ask why:  {ask}"), soft_wrap=True)
    console.print(Text("read on:  docs/architecture.md"), soft_wrap=True)


def _headline(made: Mapping[str, Any]) -> str:
    maps, robots = len(made["maps"]), len(made["agents"])
    count = "one map" if maps == 1 else f"{maps} maps" if maps else "no map"
    return f"{made['scenario']}: {count} of {robots} robot{'s' if robots != 1 else ''}"


def _agents(made: Mapping[str, Any]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    table.add_column("robot", style="bold", overflow="ellipsis")
    for heading in ("keyframes", "path", "kB/s", "ATE alone", "ATE in the map"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, agent in made["agents"].items():
        table.add_row(
            Text(name),
            str(agent["keyframes"]),
            f"{agent['path_m']:.1f} m",
            f"{agent['kB_per_s']:.0f}",
            metres(agent["ate_before_m"]),
            metres(agent["ate_after_m"]),
        )
    return table


def _facts(made: Mapping[str, Any]) -> list[tuple[str, Text]]:
    lost = made["keyframes_lost"]
    facts = [
        ("maps", Text("; ".join(" ".join(agents) for agents in made["maps"]) or "none")),
        ("loops", _loops(made["loops"])),
    ]
    if made["loops"]["wrong"] is not None:
        facts.append(("wrong", _wrong(made["loops"])))
    facts.append(("joint ATE", _joint_ate(made)))
    facts.append(("lost", Text(f"{lost} keyframes" if lost else "no keyframe", _mark(not lost))))
    if "phases_s" in made:
        phases = ", ".join(f"{name} {lap_s:.1f}" for name, lap_s in made["phases_s"].items())
        facts.append(("time", Text(f"{made['wall_s']:.0f} s ({phases})")))
    return facts


def _loops(loops: Mapping[str, Any]) -> Text:
    return Text(
        f"{loops['accepted']} of {loops['candidates']} candidates: "
        f"{loops['intra']} within a robot, {loops['inter']} between robots"
    )


def _wrong(loops: Mapping[str, Any]) -> Text:
    """How many loops are wrong, and whether that matters; the words are those of the report."""
    wrong, bending = loops["wrong"], loops["wrong_bending"]
    if not wrong:
        return Text(f"none; the worst is off by {metres(loops['t_err_max_m'])}", _mark(True))
    share = 100 * wrong / loops["with_groundtruth"]
    harm = f"{bending or 'none'} {'bend' if bending > 1 else 'bends'} the map"
    worst = f"the worst is off by {metres(loops['t_err_max_m'])}"
    return Text(f"{wrong} loops ({share:.1f} %), {harm}; {worst}", _mark(not bending))


def _joint_ate(made: Mapping[str, Any]) -> Text:
    before_m, after_m = made["joint_ate_before_m"], made["joint_ate_after_m"]
    if before_m is None or after_m is None:
        return Text("unknown: there is no ground truth")
    text = f"{metres(before_m)} (each odometry aligned alone) {_ARROW} {metres(after_m)}"
    if min(before_m, after_m) > 0:
        better = before_m >= after_m
        factor = max(before_m, after_m) / min(before_m, after_m)
        text += f", {factor:.1f} times {'better' if better else 'worse'}"
    return Text(text, _mark(after_m <= before_m))


def _where_to_look(folder: Path, files: Sequence[Path]) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column(style="dim", overflow="fold")
    table.add_row(Text(f"{_shown(folder)}/", style="bold"), "")
    names = {file.name for file in files}
    for name, what in _FILES.items():
        if name in names:
            table.add_row(f"  {name}", what)
    return table


def _shown(folder: Path) -> str:
    """The folder as seen from the current one, if it lies below it."""
    path = os.path.relpath(folder)
    return str(folder) if path.startswith("..") else path


def _mark(good: bool) -> str:
    return "green" if good else "yellow"


def metres(value_m: float | None) -> str:
    """An error for people: 3.1 cm, 4.23 m, or - where it is not known."""
    if value_m is None:
        return "-"
    return f"{100 * value_m:.1f} cm" if value_m < 1 else f"{value_m:.2f} m"
