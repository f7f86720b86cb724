"""The pictures of a run: top view, view in space, errors over time, loops and rejections."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from covinz.pictures import style
from covinz.pictures.error_over_time import draw_error_over_time
from covinz.pictures.loops import draw_loops
from covinz.pictures.map_3d import draw_map_3d
from covinz.pictures.subject import Subject, subject_of
from covinz.pictures.top_view import draw_top_view
from covinz.record import RunRecord

Draw = Callable[[Path, Subject, Mapping[str, Any]], None]
PICTURES: Mapping[str, Draw] = {
    "top_view.png": draw_top_view,
    "map_3d.png": draw_map_3d,
    "error_over_time.png": draw_error_over_time,
    "loops.png": draw_loops,
}


def draw(record: RunRecord, made: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the pictures of a run; the same run gives the same bytes.

    Args:
        record: What the run left.
        made: Its report.
        folder: Where to write.

    Returns:
        The files; none where there is no map.
    """
    subject = subject_of(record)
    if not subject.maps:
        return []
    files = []
    with style.applied():
        for name, draw_picture in PICTURES.items():
            files.append(folder / name)
            draw_picture(files[-1], subject, made)
    return files
