"""Where the pictures look from: projections to the plane, limits of panels, the scale bar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from covinz.pictures import style
from covinz.types import Array

# A direction of least motion within this of z makes z up. [cosine]
_NEAR_VERTICAL = 0.7
# Height by width of a panel: flatter and taller data are given more room around them.
_FLATTEST, _TALLEST = 0.22, 1.05
_AZIMUTH_RAD, _ELEVATION_RAD = np.deg2rad([30.0, 35.0])


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of the drawn plane [m]."""

    left: float
    bottom: float
    right: float
    top: float

    @property
    def aspect(self) -> float:
        """Height by width."""
        return (self.top - self.bottom) / (self.right - self.left)


def upright(points_m: Array, z_is_up: bool) -> Array:
    """Rotation (3, 3) to axes along the motion: wide, deep, up.

    Frames of cameras are not z-up, so up is found as the direction of least motion, unless that
    is about z or z is known to be up.

    Args:
        points_m: (N, 3) what will be drawn.
        z_is_up: Whether the frame is known to have z up.
    """
    centred = points_m - points_m.mean(axis=0)
    _, vectors = np.linalg.eigh(centred.T @ centred)
    up, wide = vectors[:, 0], vectors[:, 2]
    if z_is_up or abs(up[2]) > _NEAR_VERTICAL:
        spans = np.ptp(centred[:, :2], axis=0)
        turned = spans[1] > 1.25 * spans[0]
        return np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]] if turned else np.eye(3), dtype=float)
    # The largest component of a camera's up is -y, of anything else's it is positive.
    largest = int(np.argmax(np.abs(up)))
    up = up * np.sign(up[largest]) * (-1.0 if largest == 1 else 1.0)
    wide = wide if wide[int(np.argmax(np.abs(wide)))] > 0 else -wide
    return np.stack([wide, np.cross(up, wide), up])


def from_above(R: Array) -> Array:
    """(3, 2) projection of points onto the plane of `upright`'s first two axes."""
    return np.asarray(R[:2].T)


def from_the_side(R: Array) -> Array:
    """(3, 2) parallel projection from a raised point beside the scene; up stays up."""
    c, s = np.cos(_AZIMUTH_RAD), np.sin(_AZIMUTH_RAD)
    sine, cosine = np.sin(_ELEVATION_RAD), np.cos(_ELEVATION_RAD)
    screen = np.array([[c, -s, 0.0], [sine * s, sine * c, cosine]])
    return np.asarray((screen @ R).T)


def box_of(points: Sequence[Array], margin: float = 0.05) -> Box:
    """Smallest box around (N, 2) points with a margin, widened to the shape of a panel."""
    joined = np.concatenate(list(points))
    low, high = joined.min(axis=0), joined.max(axis=0)
    width, height = np.maximum(high - low, 1e-3 + 1e-3 * np.max(high - low)) * (1 + 2 * margin)
    width = max(width, height / _TALLEST)
    height = max(height, width * _FLATTEST)
    x, y = (low + high) / 2
    return Box(x - width / 2, y - height / 2, x + width / 2, y + height / 2)


def shaped(box: Box, aspect: float) -> Box:
    """The smallest box around this one with the same centre and this height by width."""
    width = max(box.right - box.left, (box.top - box.bottom) / aspect)
    x, y = (box.left + box.right) / 2, (box.bottom + box.top) / 2
    return Box(x - width / 2, y - width * aspect / 2, x + width / 2, y + width * aspect / 2)


def show(axis: Axes, box: Box) -> None:
    """Show exactly this box, without ticks."""
    axis.set(xlim=(box.left, box.right), ylim=(box.bottom, box.top), xticks=[], yticks=[])


def nice_length(limit_m: float) -> float:
    """Largest of 1, 2, 5 times a power of ten that is not beyond a limit."""
    power = 10.0 ** np.floor(np.log10(limit_m))
    return float(power * max(step for step in (1, 2, 5) if step * power <= limit_m * (1 + 1e-9)))


def scale_bar(axis: Axes, box: Box, drawn: Array) -> None:
    """A bar of a round length in the corner where the fewest of the drawn (N, 2) points are."""
    width = box.right - box.left
    length, inset = nice_length(width / 4), 0.03 * width
    x, y = _emptiest(box, drawn, np.array([length + 2 * inset, 0.09 * width])) + inset
    bar = Line2D([x, x + length], [y, y], color=style.TEXT, linewidth=2.2, zorder=9)
    bar.set(solid_capstyle="butt", path_effects=style.halo(5))
    axis.add_line(bar)
    axis.annotate(
        metres(length),
        (x + length / 2, y),
        (0, 4),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=9,
        path_effects=style.halo(),
        zorder=9,
    )


def corner_note(axis: Axes, box: Box, drawn: Array, words: str) -> None:
    """A word in the corner where the fewest of the drawn (N, 2) points are."""
    width = box.right - box.left
    room = np.array([0.28, 0.06]) * width
    x, y = _emptiest(box, drawn, room) + room / 2
    axis.text(
        x,
        y,
        words,
        ha="center",
        va="center",
        fontsize=9,
        color=style.QUIET,
        path_effects=style.halo(),
        zorder=9,
    )


def _emptiest(box: Box, drawn: Array, room: Array) -> Array:
    """Lower left point of the room (2,) in that corner of the box; the lower left one if equal."""
    corners = [
        np.array([x, y])
        for y in (box.bottom, box.top - room[1])
        for x in (box.left, box.right - room[0])
    ]
    counts = [int(((drawn >= c) & (drawn <= c + room)).all(axis=1).sum()) for c in corners]
    return corners[int(np.argmin(counts))]


def metres(length_m: float) -> str:
    """A round length for people: 2 mm, 20 cm, 5 m, 2 km."""
    if length_m == 0:
        return "0"
    if length_m < 0.00999:
        return f"{1000 * length_m:g} mm"
    if length_m < 0.999:
        return f"{100 * length_m:g} cm"
    return f"{length_m:g} m" if length_m < 999 else f"{length_m / 1000:g} km"
