"""Panels of paths: every robot before and after, on whatever plane a projection gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from covinz import frames
from covinz.pictures import style, view
from covinz.pictures.subject import MapSubject, Subject, Track
from covinz.types import Array

MAX_MAPS = 3
_EDGE_IN, _GAP_IN, _NAME_IN = 0.12, 0.14, 0.28
# A panel that would be flatter than this beside another is given the whole width.
_FLAT = 0.36
# A plan that is more than so many times larger than the paths is cut off around them.
LARGE_PLAN = 2.5
# A robot has set off when it is this share of its way away.
_SETTING_OFF = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One panel: paths of robots, and the map that they are in.

    Attributes:
        name: What it shows.
        tracks: Whose paths.
        paths_m: Their (N, 3) points.
        truths_m: (K, 3) true paths, pale; may be none.
        R: (3, 3) rotation to axes that go wide, deep and up; see `view.upright`.
        P: (3, 2) projection of points to the drawn plane.
        in_world: Whether the paths are in the world frame.
        found: The map whose loops are drawn; None: none.
    """

    name: str
    tracks: Sequence[Track]
    paths_m: Sequence[Array]
    truths_m: Sequence[Array]
    R: Array
    P: Array
    in_world: bool
    found: MapSubject | None = None

    @property
    def drawn(self) -> list[Array]:
        """(N, 2) points of all its paths on the drawn plane."""
        return [points @ self.P for points in (*self.paths_m, *self.truths_m)]


Below = Callable[[Axes, Panel], None]
Scale = Callable[[Axes, Panel, view.Box, Array], None]


def panels_of(
    subject: Subject, project: Callable[[Array], Array], *, show_drift: bool = True
) -> list[Panel]:
    """The panel before, and one for each of the largest maps.

    Args:
        subject: What to draw; at least one map.
        project: Makes of `view.upright` a projection (3, 2) to the drawn plane.
        show_drift: Lay the odometry into the world where that is known; otherwise, and elsewhere,
            each robot is in a frame of its own, as it was when it knew nothing of the others.
    """
    maps = subject.maps[:MAX_MAPS]
    together = np.concatenate([track.after_m for track in subject.tracks])
    shared = view.upright(together, bool(subject.plan))
    turns = [
        shared
        if subject.aligned
        else view.upright(np.concatenate([track.after_m for track in found.tracks]), False)
        for found in maps
    ]
    before = (
        _drifting(subject, turns[0], project)
        if subject.aligned and show_drift
        else _alone(subject, turns[0], project)
    )
    after = [
        Panel(
            _name(subject, number),
            found.tracks,
            [track.after_m for track in found.tracks],
            [track.truth_m for track in found.tracks],
            R,
            project(R),
            found.aligned,
            found,
        )
        for number, (found, R) in enumerate(zip(maps, turns, strict=True))
    ]
    return [before, *after]


def _drifting(subject: Subject, R: Array, project: Callable[[Array], Array]) -> Panel:
    return Panel(
        "Before: odometry alone, each from its true start (dot)",
        subject.tracks,
        [track.before_m for track in subject.tracks],
        [track.truth_m for track in subject.tracks],
        R,
        project(R),
        True,
    )


def _alone(subject: Subject, R: Array, project: Callable[[Array], Array]) -> Panel:
    """All start at one point and set off to the right: none knows where the others are."""
    paths = []
    for track in subject.tracks:
        path = (track.before_m - track.before_m[0]) @ R.T
        away = np.linalg.norm(path[:, :2], axis=1)
        first = path[int(np.argmax(away > _SETTING_OFF * away.max()))]
        turn = frames.so3_exp([0.0, 0.0, -np.arctan2(first[1], first[0])])
        paths.append(path @ turn.T @ R)
    return Panel(
        "Before: each robot alone, in a frame of its own (dot: start)",
        subject.tracks,
        paths,
        [],
        R,
        project(R),
        False,
    )


def _name(subject: Subject, number: int) -> str:
    found, count = subject.maps[number], len(subject.maps)
    if count == 1:
        return "After: one map" + (", aligned once to ground truth" if found.aligned else "")
    agents = ", ".join(found.agents) if len(found.agents) <= 3 else f"{len(found.agents)} robots"
    return f"After: map {number + 1} of {count} ({agents})"


def boxes(panels: Sequence[Panel], around: Sequence[Sequence[Array]]) -> list[view.Box]:
    """What each panel shows; the same for those that show the world frame.

    Args:
        panels: All panels.
        around: (K, 2) what should be seen too on the drawn plane, unless it is much larger: one
            for each panel.
    """
    world = [number for number, panel in enumerate(panels) if panel.in_world]
    shared = [points for number in world for points in panels[number].drawn]
    seen = []
    for number, panel in enumerate(panels):
        drawn = shared if panel.in_world else panel.drawn
        box = view.box_of(drawn)
        whole = view.box_of([*drawn, *around[number]], 0.02)
        large = whole.right - whole.left > LARGE_PLAN * (box.right - box.left)
        seen.append(box if large or not len(around[number]) else whole)
    return seen


def draw(
    subject: Subject, panels: Sequence[Panel], shown: Sequence[view.Box], below: Below, scale: Scale
) -> Figure:
    """Arrange the panels on a canvas with a legend; the headline is left to the caller.

    Args:
        subject: What is drawn.
        panels: In which panels.
        shown: What each of them shows.
        below: Draws what lies under the paths.
        scale: Says how large things are, away from the (N, 2) points it is given.
    """
    colours = style.colours_of(subject.agents)
    entries = [*style.agent_entries(colours), *_entries(panels)]
    aspect = _aspect(panels, shown)
    columns = 1 if aspect < _FLAT else 2
    width = (style.WIDTH_IN - 2 * _EDGE_IN - (columns - 1) * _GAP_IN) / columns
    height, rows = width * aspect, int(np.ceil(len(panels) / columns))
    row = _NAME_IN + height + 0.08
    total = style.TITLE_IN + rows * row + style.legend_height_in(entries) + 0.05
    figure = style.canvas(total)
    for number, (panel, box) in enumerate(zip(panels, shown, strict=True)):
        left = _EDGE_IN + (number % columns) * (width + _GAP_IN)
        top = style.TITLE_IN + (number // columns) * row + _NAME_IN
        axis = style.place(figure, left, top, width, height)
        axis.set_title(panel.name, loc="left", pad=5)
        seen = view.shaped(box, aspect)
        view.show(axis, seen)
        below(axis, panel)
        _draw_panel(axis, panel, colours)
        # In the same corner where the panels show the same.
        beside = [other for other in panels if other.in_world] if panel.in_world else [panel]
        scale(axis, panel, seen, np.concatenate([p for other in beside for p in other.drawn]))
    style.legend(figure, entries)
    return figure


def draw_plan(axis: Axes, outlines: Sequence[Array]) -> None:
    """Outlines (K, 2) on the drawn plane; two points are a wall, drawn as a line."""
    wall = np.array([len(outline) == 2 for outline in outlines], dtype=bool)
    drawn = PolyCollection(
        list(outlines),
        facecolors=style.PLAN_FACE,
        edgecolors=np.where(wall, style.PLAN_WALL, style.PLAN_EDGE).tolist(),
        linewidths=0.7,
    )
    drawn.set_zorder(1)
    axis.add_collection(drawn, autolim=False)


def _aspect(panels: Sequence[Panel], shown: Sequence[view.Box]) -> float:
    """Height by width of all panels: the world's if it is drawn, else that of the tallest."""
    world = [box.aspect for panel, box in zip(panels, shown, strict=True) if panel.in_world]
    return max(world or [box.aspect for box in shown])


def _draw_panel(axis: Axes, panel: Panel, colours: dict[str, str]) -> None:
    for path in panel.truths_m:
        axis.plot(*(path @ panel.P).T, color=style.TRUTH, linewidth=4.0, zorder=2)
    if panel.found is not None:
        _draw_loops(axis, panel.found, panel.found.loop_ends_m @ panel.P)
    for track, path_m in zip(panel.tracks, panel.paths_m, strict=True):
        colour, path = colours[track.agent], path_m @ panel.P
        axis.plot(*path.T, color=colour, linewidth=1.9, zorder=5)
        axis.plot(*path[0], "o", color=colour, markersize=7, markeredgecolor="white", zorder=6)


def _draw_loops(axis: Axes, found: MapSubject, ends: Array) -> None:
    wrong, bending = found.loops.wrong, found.loops.bending
    opacity = float(np.clip(60 / max(1, len(ends)), 0.22, 0.7))
    for chosen, colour, width, alpha, z in (
        (~found.inter & ~wrong, style.INTRA, 0.7, opacity, 3.0),
        (found.inter & ~wrong, style.INTER, 0.7, opacity, 3.1),
        (wrong & ~bending, style.WRONG, 0.9, min(1.0, opacity + 0.3), 4.0),
        (bending, style.WRONG, 2.0, 1.0, 4.5),
    ):
        lines = LineCollection(list(ends[chosen]), colors=colour, linewidths=width, alpha=alpha)
        lines.set_zorder(z)
        axis.add_collection(lines, autolim=False)


def _entries(panels: Sequence[Panel]) -> list[Artist]:
    """Legend of everything that is not an agent, as far as it occurs."""
    entries: list[Artist] = []
    maps = [panel.found for panel in panels if panel.found is not None]
    if any(len(path) for panel in panels for path in panel.truths_m):
        entries.append(Line2D([], [], color=style.TRUTH, linewidth=4.0, label="ground truth"))
    for occurs, colour, width, label in (
        (any((~m.inter & ~m.loops.wrong).any() for m in maps), style.INTRA, 1.0, "loop, one robot"),
        (any((m.inter & ~m.loops.wrong).any() for m in maps), style.INTER, 1.0, "loop, two robots"),
        (any(m.loops.wrong.any() for m in maps), style.WRONG, 1.0, "wrong loop"),
        (any(m.loops.bending.any() for m in maps), style.WRONG, 2.4, "bends the map"),
    ):
        if occurs:
            entries.append(Line2D([], [], color=colour, linewidth=width, label=label))
    return entries
