"""map_3d.png: the robots in space, before and after, over the floor of their world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon

from covinz.pictures import captions, panels, style, view
from covinz.pictures.subject import Subject
from covinz.types import Array

_FLOOR, _GRID, _SHADOW, _STEM = "#F6F8F9", "#DFE5E8", "#CBD2D8", "#B4BCC3"
# So many lines from the paths of a panel down to the floor let the eye judge heights.
_STEMS = 60
# Squares along the longer side of the floor, at least.
_SQUARES = 5


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """A rectangle below the paths, in axes that go wide, deep and up [m]."""

    low: Array
    high: Array
    up: float

    @property
    def step(self) -> float:
        """Side of a square of the grid."""
        return view.nice_length(float(np.max(self.high - self.low)) / _SQUARES)

    def corners(self) -> Array:
        """(4, 3) around it."""
        (x0, y0), (x1, y1) = self.low, self.high
        return np.array([[x, y, self.up] for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))])

    def grid(self) -> Array:
        """(G, 2, 3) lines on it."""
        lines = []
        for axis in (0, 1):
            first, last = self.low[axis], self.high[axis]
            for at in np.arange(np.ceil(first / self.step) * self.step, last, self.step):
                line = np.full((2, 3), self.up)
                line[:, 1 - axis] = self.low[1 - axis], self.high[1 - axis]
                line[:, axis] = at
                lines.append(line)
        return np.array(lines).reshape(-1, 2, 3)


def floor_of(shown: Sequence[panels.Panel], plan: Sequence[Array]) -> Floor:
    """The floor below the paths of panels with the same axes.

    A world with a plan has its floor at 0 and below all of the plan, unless that is much larger.
    Elsewhere it lies a little below the last panel's paths: those before may have drifted away.
    """
    R = shown[0].R
    paths = [[p @ R.T for p in (*panel.paths_m, *panel.truths_m)] for panel in shown]
    points = np.concatenate([path for panel in paths for path in panel])[:, :2]
    if plan:
        outlines = np.concatenate([on_floor(outline) for outline in plan]) @ R.T
        if np.max(np.ptp(outlines, axis=0)) <= panels.LARGE_PLAN * np.max(np.ptp(points, axis=0)):
            points = np.concatenate([points, outlines[:, :2]])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.03 * float(np.max(high - low))
    lowest = float(np.concatenate(paths[-1])[:, 2].min())
    return Floor(low - margin, high + margin, 0.0 if plan else lowest - 2 * margin)


def on_floor(outline: Array) -> Array:
    """Points (K, 3) of an outline (K, 2) of the plan."""
    return np.column_stack([outline, np.zeros(len(outline))])


def draw_map_3d(file: Path, subject: Subject, made: Mapping[str, Any]) -> None:
    """Write the picture: a parallel projection with a grid on the floor, and stems down to it.

    Args:
        file: PNG to write.
        subject: A run with one map or more.
        made: Its report.
    """
    shown = panels.panels_of(subject, view.from_the_side)
    in_world = [panel for panel in shown if panel.in_world]
    floors = {
        id(panel): floor_of(
            in_world if panel.in_world else [panel], subject.plan if panel.in_world else ()
        )
        for panel in shown
    }

    def ground(axis: Axes, panel: panels.Panel) -> None:
        _draw_floor(axis, panel, floors[id(panel)], subject.plan if panel.in_world else ())

    def squares(axis: Axes, panel: panels.Panel, box: view.Box, drawn: Array) -> None:
        step = view.metres(floors[id(panel)].step)
        view.corner_note(axis, box, drawn, f"squares of {step}")

    corners = [[floors[id(panel)].corners() @ panel.R @ panel.P] for panel in shown]
    figure = panels.draw(subject, shown, panels.boxes(shown, corners), ground, squares)
    style.headline(figure, captions.title(made), captions.figures(made))
    style.save(figure, file)


def _draw_floor(axis: Axes, panel: panels.Panel, floor: Floor, plan: Sequence[Array]) -> None:
    onto_plane = panel.R @ panel.P
    rectangle = Polygon(floor.corners() @ onto_plane, facecolor=_FLOOR, edgecolor=_GRID)
    rectangle.set_zorder(0.5)
    axis.add_patch(rectangle)
    _lines(axis, floor.grid() @ onto_plane, _GRID, 0.6, 0.6)
    panels.draw_plan(axis, [on_floor(outline) @ panel.P for outline in plan])
    feet = []
    every = max(1, sum(map(len, panel.paths_m)) // _STEMS)
    for path_m in panel.paths_m:
        foot = path_m @ panel.R.T
        foot[:, 2] = floor.up
        axis.plot(*(foot @ onto_plane).T, color=_SHADOW, linewidth=1.4, zorder=1.2)
        feet += list(np.stack([foot @ onto_plane, path_m @ panel.P], axis=1)[::every])
    _lines(axis, np.array(feet), _STEM, 0.5, 1.4)


def _lines(axis: Axes, ends: Array, colour: str, width: float, zorder: float) -> None:
    lines = LineCollection(list(ends), colors=colour, linewidths=width)
    lines.set_zorder(zorder)
    axis.add_collection(lines, autolim=False)
