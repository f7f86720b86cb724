"""top_view.png: the robots from above, before and after, on the plan of their world."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from covinz.pictures import captions, panels, style, view
from covinz.pictures.subject import Subject
from covinz.types import Array

# An error of this share of the width of what is drawn is seen.
_VISIBLE = 0.05


def draw_top_view(file: Path, subject: Subject, made: Mapping[str, Any]) -> None:
    """Write the picture.

    Args:
        file: PNG to write.
        subject: A run with one map or more.
        made: Its report.
    """

    def plan(axis: Axes, panel: panels.Panel) -> None:
        if panel.in_world:
            panels.draw_plan(axis, [outline @ panel.P[:2] for outline in subject.plan])

    def bar(axis: Axes, _: panels.Panel, box: view.Box, drawn: Array) -> None:
        view.scale_bar(axis, box, drawn)

    shown = panels.panels_of(subject, view.from_above, show_drift=_drift_shows(subject))
    around = [
        [outline @ panel.P[:2] for outline in subject.plan] if panel.in_world else []
        for panel in shown
    ]
    figure = panels.draw(subject, shown, panels.boxes(shown, around), plan, bar)
    style.headline(figure, captions.title(made), captions.figures(made))
    style.save(figure, file)


def _drift_shows(subject: Subject) -> bool:
    """Whether odometry alone leaves the true path so far that one sees it."""
    tracks = subject.tracks
    off_m = [np.linalg.norm(track.before_m - track.true_m, axis=1) for track in tracks]
    extent_m = np.ptp(np.concatenate([track.after_m for track in tracks]), axis=0).max()
    return bool(np.nanmax(np.concatenate([[0.0], *off_m])) > _VISIBLE * extent_m)
