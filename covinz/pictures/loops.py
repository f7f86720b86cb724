"""loops.png: what became of the candidates, and how good the loops are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from covinz.loop_edges import WRONG_M
from covinz.pictures import captions, style, view
from covinz.pictures.subject import Subject
from covinz.types import Array

_REJECTED = "#D9DEE2"
_BAR_IN, _NAMES_IN, _AXIS_IN, _LEAST_IN = 0.27, 1.55, 0.46, 1.6
_BINS = 28
# Loops that are better than this are drawn as if they were not. [m]
_LEAST_M = 1e-3


def draw_loops(file: Path, subject: Subject, made: Mapping[str, Any]) -> None:
    """Write the picture: a bar for each fate of a candidate, and the errors of the loops.

    Args:
        file: PNG to write.
        subject: A run with one map or more.
        made: Its report.
    """
    rejected = made["loops"]["rejected"]
    fates = [("loop", made["loops"]["accepted"])]
    fates += sorted(rejected.items(), key=lambda item: (-item[1], item[0]))
    height = max(_LEAST_IN, _BAR_IN * len(fates))
    entries = [
        Patch(color=colour, label=label)
        for occurs, colour, label in (
            (made["loops"]["inter"], style.INTER, "loop, two robots"),
            (made["loops"]["intra"], style.INTRA, "loop, one robot"),
            (made["loops"]["wrong"], style.WRONG, "wrong loop"),
            (rejected, _REJECTED, "rejected at this stage"),
        )
        if occurs
    ]
    top = style.TITLE_IN + 0.28
    figure = style.canvas(top + height + _AXIS_IN + style.legend_height_in(entries))
    style.headline(figure, f"{made['scenario']}: loops", _line(made))
    kinds = _kinds(subject)
    known = any(np.isfinite(errors_m).any() for errors_m in kinds.values())
    wide = style.WIDTH_IN - _NAMES_IN - 0.2
    left = style.place(figure, _NAMES_IN, top, 2.9 if known else wide, height)
    _draw_fates(left, fates, kinds)
    if known:
        right = style.place(figure, 5.0, top, style.WIDTH_IN - 5.0 - 0.2, height)
        _draw_errors(right, kinds)
    style.legend(figure, entries)
    style.save(figure, file)


def _line(made: Mapping[str, Any]) -> str:
    found, ms = made["loops"], made["solver_ms"]
    line = f"{captions.loops(made)}, of {found['candidates']} candidates"
    if ms["median"] is not None:
        line += f"  \N{MIDDLE DOT}  {ms['median']:.0f} ms each (median)"
    return line


def _kinds(subject: Subject) -> dict[str, Array]:
    """Errors of the loops [m], NaN where unknown, by the colour of their kind."""
    kinds: dict[str, list[Array]] = {style.INTER: [], style.INTRA: [], style.WRONG: []}
    for found in subject.maps:
        errors_m, wrong = found.loops.translation_m, found.loops.wrong
        kinds[style.INTER].append(errors_m[found.inter & ~wrong])
        kinds[style.INTRA].append(errors_m[~found.inter & ~wrong])
        kinds[style.WRONG].append(errors_m[wrong])
    return {colour: np.concatenate(parts) for colour, parts in kinds.items()}


def _draw_fates(axis: Axes, fates: list[tuple[str, int]], kinds: Mapping[str, Array]) -> None:
    """Bars of equal scale, the loops on top."""
    for row, (_, count) in enumerate(fates[1:], start=1):
        axis.barh(row, count, color=_REJECTED, height=0.72)
    start = 0
    for colour, errors_m in kinds.items():
        axis.barh(0, len(errors_m), left=start, color=colour, height=0.72)
        start += len(errors_m)
    most = max(1, *(count for _, count in fates))
    for row, (_, count) in enumerate(fates):
        axis.text(count + 0.02 * most, row, str(count), va="center", fontsize=9)
    axis.set_yticks(range(len(fates)), [name.replace("_", " ") for name, _ in fates])
    axis.set(ylim=(len(fates) - 0.4, -0.6), xlim=(0, 1.18 * most), xticks=[])
    axis.tick_params(length=0, labelcolor=style.TEXT)
    axis.spines[["top", "right", "bottom"]].set_visible(False)
    axis.set_title("what became of the candidates", loc="left", pad=6)


def _draw_errors(axis: Axes, kinds: Mapping[str, Array]) -> None:
    """Histogram of the loops' errors, on a logarithmic axis."""
    columns = [np.maximum(errors_m[np.isfinite(errors_m)], _LEAST_M) for errors_m in kinds.values()]
    joined = np.concatenate([*columns, [WRONG_M]])
    edges = np.geomspace(joined.min() / 1.1, joined.max() * 1.1, _BINS + 1)
    axis.hist(columns, edges.tolist(), color=list(kinds), stacked=True)
    axis.axvline(WRONG_M, color=style.WRONG, linewidth=1.0, ls=":")
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: view.metres(value)))
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0), numticks=8))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.tick_params(length=0)
    axis.spines[["top", "right"]].set_visible(False)
    axis.set_title("how far the loops are off (dotted: wrong from here on)", loc="left", pad=6)
