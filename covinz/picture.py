"""The picture of a run: what the robots knew alone, and the common map, seen from above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Okabe and Ito's palette: told apart by colour-blind readers too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000")


@dataclass(frozen=True, slots=True, eq=False)
class MapDrawing:
    """One map to draw.

    Attributes:
        paths: (N, 3) positions of each segment in the map frame, by agent.
        loops: (L, 2, 3) ends of the loop edges.
        groundtruth: (N, 3) true positions of each agent in the map frame; may be empty.
    """

    paths: Mapping[str, Sequence[Array]]
    loops: Array
    groundtruth: Mapping[str, Array]


def draw_top_view(
    file: Path, before: Mapping[str, Sequence[Array]], after: Sequence[MapDrawing], title: str
) -> None:
    """Write a PNG: each odometry in its own frame, then every map.

    Args:
        file: PNG file to write.
        before: (N, 3) odometry positions of each segment, by agent.
        after: The maps, largest first; a map is one panel, four at most.
        title: Line above the panels.
    """
    matplotlib.use("Agg")
    shown = list(after[:4])
    figure = Figure(figsize=(6.0 * (1 + max(1, len(shown))), 5.6), layout="constrained")
    axes = figure.subplots(1, 1 + max(1, len(shown)), squeeze=False)[0]
    colours = {agent: COLOURS[i % len(COLOURS)] for i, agent in enumerate(sorted(before))}
    _draw_before(axes[0], before, colours)
    for number, (axis, drawing) in enumerate(zip(axes[1:], shown, strict=False)):
        _draw_map(axis, drawing, colours)
        agents = ", ".join(sorted(drawing.paths))
        name = "One map" if len(after) == 1 else f"Map {number + 1} of {len(after)}"
        axis.set_title(f"{name}: {agents} ({len(drawing.loops)} loops)")
    figure.suptitle(title)
    figure.savefig(file, dpi=110)


def _draw_before(
    axis: Axes, before: Mapping[str, Sequence[Array]], colours: Mapping[str, str]
) -> None:
    view = _from_above([path for paths in before.values() for path in paths])
    for agent, paths in sorted(before.items()):
        for path in paths:
            axis.plot(*(path @ view).T, color=colours[agent], linewidth=1.4)
            axis.plot(*(path[0] @ view), "o", color=colours[agent], markersize=6)
        axis.plot([], [], color=colours[agent], label=agent)
    axis.set_title("Odometry, each robot in its own frame (dot: start)")
    _finish(axis)


def _draw_map(axis: Axes, drawing: MapDrawing, colours: Mapping[str, str]) -> None:
    view = _from_above([path for paths in drawing.paths.values() for path in paths])
    for index, path in enumerate(drawing.groundtruth.values()):
        label = "ground truth" if index == 0 else None
        axis.plot(*(path @ view).T, color="0.72", linewidth=3.0, label=label, zorder=1)
    if len(drawing.loops):
        lines = LineCollection(
            list(drawing.loops @ view), colors="0.25", linewidths=0.5, alpha=0.5, zorder=2
        )
        axis.add_collection(lines)
        axis.plot([], [], color="0.25", linewidth=0.8, label="loop closure")
    for agent, paths in sorted(drawing.paths.items()):
        for path in paths:
            axis.plot(*(path @ view).T, ".-", color=colours[agent], linewidth=1.2, markersize=4)
        axis.plot([], [], color=colours[agent], label=agent)
    _finish(axis)


def _from_above(paths: Sequence[Array]) -> Array:
    """(3, 2) projection along the direction in which the motion is smallest.

    Odometry frames of cameras are not z-up, so the plane of motion is found from the data.
    """
    points = np.concatenate([path - path.mean(axis=0) for path in paths])
    _, vectors = np.linalg.eigh(points.T @ points)
    view: Array = vectors[:, [2, 1]]
    return view * np.where(view.sum(axis=0) < 0, -1.0, 1.0)


def _finish(axis: Axes) -> None:
    axis.set_aspect("equal", adjustable="datalim")
    axis.grid(True, color="0.9")
    axis.set_xlabel("metres")
    axis.legend(loc="best", fontsize=8)
