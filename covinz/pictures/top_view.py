"""top_view.png: the robots from above, before and after, on the plan of their world."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from covinz.pictures import captions, panels, style, view
from covinz.pictures.subject import Subject
from covinz.types import Array


def draw_top_view(file: Path, subject: Subject, made: Mapping[str, Any]) -> None:
    """Write the picture.

    Args:
        file: PNG to write.
        subject: A run with one map or more.
        made: Its report.
    """

    def plan(axis: Axes, panel: panels.Panel) -> None:
        outlines = PolyCollection(
            [outline @ panel.P[:2] for outline in subject.plan],
            facecolors=style.PLAN_FACE,
            edgecolors=style.PLAN_EDGE,
            linewidths=0.6,
        )
        outlines.set_zorder(1)
        axis.add_collection(outlines, autolim=False)

    def bar(axis: Axes, _: panels.Panel, box: view.Box, drawn: Array) -> None:
        view.scale_bar(axis, box, drawn)

    shown = panels.panels_of(subject, view.from_above)
    around = [outline @ shown[0].P[:2] for outline in subject.plan]
    figure = panels.draw(subject, shown, panels.boxes(subject, shown, around), plan, bar)
    style.headline(figure, captions.title(made), captions.figures(made))
    style.save(figure, file)
