"""error_over_time.png: how far each robot is off, by odometry alone and in the map.

With ground truth: distance from the true position, of the odometry (aligned by the true pose of its
first keyframe alone, so that its drift grows before the eyes) and of the map (aligned once to the
truth). Without: how far the map has moved each keyframe from where the odometry alone has it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator
from numpy.typing import NDArray

from covinz.pictures import captions, style, view
from covinz.pictures.joining import Joining, joinings
from covinz.pictures.subject import MapSubject, Subject, Track
from covinz.types import Array

_ROW_IN, _LEFT_IN, _RIGHT_IN, _AXIS_IN, _GAP_IN = 1.3, 0.64, 0.14, 0.46, 0.12
# A logarithm is easier to read when odometry alone is that many times worse than the map.
_LOGARITHMIC = 25.0
# Times are counted from each robot's own start when the robots' times hardly overlap.
_APART = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Errors along one track.

    Attributes:
        agent: Whose.
        times_s: (K,) since the start of the axis.
        before_m: (K,) of the odometry alone; empty without ground truth.
        after_m: (K,) of the map, or how far it moved the keyframe.
        ticks_s: (E,) times of the loops' ends on this track.
        inter: (E,) loops with another agent.
        wrong: (E,) loops that are wrong.
        joined_s: When it was first linked to another agent; None: never.
        partner: To whom.
    """

    agent: str
    times_s: Array
    before_m: Array
    after_m: Array
    ticks_s: Array
    inter: NDArray[np.bool_]
    wrong: NDArray[np.bool_]
    joined_s: float | None
    partner: str


def draw_error_over_time(file: Path, subject: Subject, made: Mapping[str, Any]) -> None:
    """Write the picture: a row for each robot, one axis of time and of errors for all.

    Args:
        file: PNG to write.
        subject: A run with one map or more.
        made: Its report.
    """
    curves, own_start = curves_of(subject)
    colours = style.colours_of(subject.agents)
    entries = _entries(curves)
    rows = len(colours)
    figure = style.canvas(
        style.TITLE_IN + rows * (_ROW_IN + _GAP_IN) + _AXIS_IN + style.legend_height_in(entries)
    )
    style.headline(figure, _title(subject, made), _line(subject, made))
    width = style.WIDTH_IN - _LEFT_IN - _RIGHT_IN
    axes = []
    for number, (agent, colour) in enumerate(colours.items()):
        top = style.TITLE_IN + number * (_ROW_IN + _GAP_IN) + 0.05
        axis = style.place(figure, _LEFT_IN, top, width, _ROW_IN)
        _draw_row(axis, agent, [curve for curve in curves if curve.agent == agent], colour)
        axes.append(axis)
    _share(axes, curves, own_start)
    style.legend(figure, entries)
    style.save(figure, file)


def curves_of(subject: Subject) -> tuple[list[Curve], bool]:
    """The curves of all tracks, and whether each agent's time starts at its own first keyframe."""
    starts: dict[str, int] = {}
    ends: dict[str, int] = {}
    for track in subject.tracks:
        starts[track.agent] = min(starts.get(track.agent, 2**63), int(track.stamps_ns[0]))
        ends[track.agent] = max(ends.get(track.agent, 0), int(track.stamps_ns[-1]))
    first = min(starts.values())
    longest = max(ends[agent] - starts[agent] for agent in starts)
    own_start = max(ends.values()) - first > _APART * longest
    curves = []
    for found in subject.maps:
        met = joinings(found)
        for number, track in enumerate(found.tracks):
            start_ns = starts[track.agent] if own_start else first
            curves.append(_curve(track, found, start_ns, met.get(number), subject.aligned))
    return curves, own_start


def _curve(
    track: Track, found: MapSubject, start_ns: int, met: Joining | None, aligned: bool
) -> Curve:
    seconds = (track.stamps_ns - start_ns) / 1e9
    known = np.isfinite(track.true_m[:, 0]) if aligned else np.ones(len(seconds), dtype=bool)
    if aligned:
        before, after = (
            np.linalg.norm((path - track.true_m)[known], axis=1)
            for path in (track.before_m, track.after_m)
        )
    else:
        paths = (track.after_m - track.after_m[0]) - (track.before_m - track.before_m[0])
        before, after = np.zeros(0), np.linalg.norm(paths, axis=1)
    ends = np.concatenate([found.loops.cand, found.loops.query])
    at = {int(i): row for row, i in enumerate(track.keyframes)}
    here = np.array([int(i) in at for i in ends], dtype=bool)
    return Curve(
        track.agent,
        seconds[known],
        before,
        after,
        np.array([seconds[at[int(i)]] for i in ends[here]]),
        np.tile(found.inter, 2)[here],
        np.tile(found.loops.wrong, 2)[here],
        None if met is None else (met.stamp_ns - start_ns) / 1e9,
        "" if met is None else met.partner,
    )


def _title(subject: Subject, made: Mapping[str, Any]) -> str:
    if subject.aligned:
        return f"{made['scenario']}: position error over time"
    return f"{made['scenario']}: how far the map has moved each robot"


def _line(subject: Subject, made: Mapping[str, Any]) -> str:
    if not subject.aligned:
        return "no ground truth: distance of each keyframe in the map from odometry alone"
    one = "the map" if len(subject.maps) == 1 else "each map"
    return f"odometry alone starts at its true first pose; {one} is aligned once to ground truth"


def _draw_row(axis: Axes, agent: str, curves: Sequence[Curve], colour: str) -> None:
    for curve in curves:
        if len(curve.before_m):
            # Zero at the start has no logarithm.
            drawn = np.where(curve.before_m > 0, curve.before_m, np.nan)
            axis.plot(curve.times_s, drawn, color=colour, linewidth=1.3, ls=(0, (4, 2)))
        axis.plot(curve.times_s, curve.after_m, color=colour, linewidth=2.4, zorder=4)
        _draw_ticks(axis, curve)
        if curve.joined_s is not None:
            axis.axvline(curve.joined_s, color=style.QUIET, linewidth=0.9, ls=":", zorder=1)
    axis.grid(True, color="#ECEFF1", linewidth=0.7)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    for words, x, weight, tint in (
        (agent, 0.006, "bold", colour),
        (_figures(curves), 0.996, "normal", style.QUIET),
    ):
        axis.text(
            x,
            0.97,
            words,
            color=tint,
            fontweight=weight,
            fontsize=10 if x < 0.5 else 9,
            ha="left" if x < 0.5 else "right",
            va="top",
            transform=axis.transAxes,
            path_effects=style.halo(),
            zorder=8,
        )


def _draw_ticks(axis: Axes, curve: Curve) -> None:
    for chosen, colour, top, width in (
        (~curve.inter & ~curve.wrong, style.INTRA, 0.08, 0.9),
        (curve.inter & ~curve.wrong, style.INTER, 0.08, 0.9),
        (curve.wrong, style.WRONG, 0.14, 1.2),
    ):
        axis.vlines(
            np.unique(curve.ticks_s[chosen]), 0.0, top, color=colour, linewidth=width,
            transform=axis.get_xaxis_transform(), zorder=3,
        )  # fmt: skip


def _figures(curves: Sequence[Curve]) -> str:
    after = np.concatenate([curve.after_m for curve in curves])
    before = np.concatenate([curve.before_m for curve in curves])
    met = [curve for curve in curves if curve.joined_s is not None]
    words = [f"first loop with {met[0].partner} at {met[0].joined_s:.0f} s"] if met else []
    if len(before):
        alone, mapped = captions.error(before.max()), captions.error(after.max())
        words.append(f"at most {alone} alone, {mapped} in the map")
    elif len(after):
        words.append(f"moved by {captions.error(after.max())} at most")
    return "  \N{MIDDLE DOT}  ".join(words)


def _share(axes: Sequence[Axes], curves: Sequence[Curve], own_start: bool) -> None:
    """Give all rows one axis of time and one of errors."""
    after = np.concatenate([curve.after_m for curve in curves])
    everything = np.concatenate([after, *(curve.before_m for curve in curves)])
    last = max((curve.times_s.max() for curve in curves if len(curve.times_s)), default=1.0)
    top = float(everything.max()) if len(everything) else 1.0
    middle = float(np.median(after)) if len(after) else top
    logarithmic = middle > 0 and np.percentile(everything, 95) > _LOGARITHMIC * middle
    for axis in axes:
        axis.set_xlim(-0.01 * last, 1.01 * max(last, 1e-3))
        if logarithmic:
            axis.set_yscale("log")
            axis.set_ylim(middle / 8, top * 4)
        else:
            axis.set_ylim(-0.14 * max(top, 1e-6), 1.3 * max(top, 1e-6))
            axis.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: view.metres(value)))
        axis.yaxis.set_minor_locator(NullLocator())
        axis.tick_params(labelbottom=axis is axes[-1], length=0)
    whose = "its own first keyframe" if own_start else "the first keyframe"
    axes[-1].set_xlabel(f"seconds since {whose}")


def _entries(curves: Sequence[Curve]) -> list[Artist]:
    entries: list[Artist] = []
    if any(len(curve.before_m) for curve in curves):
        entries.append(
            Line2D([], [], color=style.TEXT, linewidth=1.3, ls=(0, (4, 2)), label="odometry alone")
        )
    entries.append(Line2D([], [], color=style.TEXT, linewidth=2.4, label="in the map"))
    for occurs, colour, label in (
        (any((~c.inter & ~c.wrong).any() for c in curves), style.INTRA, "loop, one robot"),
        (any((c.inter & ~c.wrong).any() for c in curves), style.INTER, "loop, two robots"),
        (any(c.wrong.any() for c in curves), style.WRONG, "wrong loop"),
    ):
        if occurs:
            entries.append(
                Line2D([], [], color=colour, ls="", marker="|", markersize=9, label=label)
            )
    if any(curve.joined_s is not None for curve in curves):
        entries.append(
            Line2D([], [], color=style.QUIET, linewidth=0.9, ls=":", label="first met another")
        )
    return entries
