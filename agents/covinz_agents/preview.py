"""A contact sheet of what a scenario's robots see: a row of images for each of them.

python -m covinz_agents.preview SCENARIO --out FILE.png [--columns N] [--width PX] [--seed N]

Exit code 0: the picture is written; 2: the scenario, its data or the file cannot be used.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz.config import ConfigError
from covinz.scenario import Scenario, load_scenario
from covinz.trajectory import TrajectoryError
from covinz_agents.source import DatasetError, Source
from covinz_agents.staging import open_source

log = logging.getLogger(__name__)

_GAP_PX = 4
_WHITE = 255


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    arguments = _parser().parse_args(argv)
    try:
        scenario = load_scenario(arguments.scenario)
        if arguments.seed is not None:
            scenario = scenario.model_copy(update={"seed": arguments.seed})
        sheet = contact_sheet(scenario, arguments.columns, arguments.width)
        _write(arguments.out, sheet)
    except (ConfigError, DatasetError, TrajectoryError, OSError) as error:
        log.error("%s", error)
        return 2
    return 0


def contact_sheet(scenario: Scenario, columns: int, width_px: int) -> NDArray[np.uint8]:
    """Images (H, W, 3) BGR spread evenly over the way of each robot, a row for each.

    Args:
        scenario: Whose robots.
        columns: Images of each.
        width_px: Of each image.

    Raises:
        DatasetError: If a robot's images cannot be had.
        TrajectoryError, ConfigError: If a recording cannot be read.
    """
    rows = [_row(open_source(agent, scenario), columns, width_px) for agent in scenario.agents]
    return _stacked(rows, axis=0)


def _row(source: Source, columns: int, width_px: int) -> NDArray[np.uint8]:
    chosen = (np.arange(columns) + 0.5) / columns * len(source.frames)
    images = [source.image(source.frames[int(k)]) for k in chosen]
    height_px = round(width_px * images[0].shape[0] / images[0].shape[1])
    size = width_px, height_px
    small = [cv2.resize(_colour(image), size, interpolation=cv2.INTER_AREA) for image in images]
    return _stacked([np.asarray(image, dtype=np.uint8) for image in small], axis=1)


def _colour(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if image.ndim == 3:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)


def _stacked(images: Sequence[NDArray[np.uint8]], axis: int) -> NDArray[np.uint8]:
    """Images one after the other, with white between them; filled up with white to one size."""
    across = 1 - axis
    widest = max(image.shape[across] for image in images)
    parts: list[NDArray[np.uint8]] = []
    for number, image in enumerate(images):
        room = [(0, 0), (0, 0), (0, 0)]
        room[across] = (0, widest - image.shape[across])
        room[axis] = (_GAP_PX if number else 0, 0)
        parts.append(np.pad(image, room, constant_values=_WHITE))
    return np.concatenate(parts, axis=axis)


def _write(path: Path, image: NDArray[np.uint8]) -> None:
    kind = path.suffix or ".png"
    try:
        encoded = cv2.imencode(kind, image)[1]
    except cv2.error as error:
        raise DatasetError(f"{path}: OpenCV writes no {kind} files") from error
    path.write_bytes(encoded.tobytes())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m covinz_agents.preview", description=__doc__)
    parser.add_argument("scenario", type=Path, help="scenario file")
    parser.add_argument("--out", type=Path, required=True, help="picture to write")
    parser.add_argument("--columns", type=int, default=4, help="images of each robot")
    parser.add_argument("--width", type=int, default=376, help="of each image [px]")
    parser.add_argument("--seed", type=int, help="instead of the scenario's")
    return parser


if __name__ == "__main__":
    sys.exit(main())
