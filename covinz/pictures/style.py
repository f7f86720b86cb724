"""How all pictures of a run look: colours, type, canvas, scale bar, legend.

Made for a README's width: 9 inches are shown on some 900 pixels, so 10 points are read as 14 px.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Stroke, withStroke
from numpy.typing import NDArray
from PIL import Image

# Okabe and Ito's palette without its red, which is kept for what is wrong: told apart by
# colour-blind readers too.
AGENT_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#222222", "#B8A900")
WRONG = "#D7191C"
INTER = "#4A4A4A"
INTRA = "#9AA0A6"
TRUTH = "#C4C9CE"
PLAN_FACE, PLAN_EDGE, PLAN_WALL = "#E6EAED", "#C9D0D6", "#A3ADB5"
TEXT, QUIET = "#1B1F23", "#6A737D"

WIDTH_IN = 9.0
DPI = 150
TITLE_IN = 0.64
_EXACT_COLOURS = 96
_SETTINGS = {
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "text.color": TEXT,
    "axes.edgecolor": "#D0D7DE",
    "axes.labelcolor": QUIET,
    "axes.titlesize": 10.0,
    "axes.linewidth": 0.8,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
}


@contextmanager
def applied() -> Iterator[None]:
    """Draw in this style, whatever the user's own settings of matplotlib are."""
    with rc_context(), matplotlib.style.context("default"), rc_context(_SETTINGS):
        yield


def colours_of(agents: Sequence[str]) -> dict[str, str]:
    """A colour for each agent, by its place in the list."""
    return {agent: AGENT_COLOURS[i % len(AGENT_COLOURS)] for i, agent in enumerate(agents)}


def canvas(height_in: float) -> Figure:
    """An empty white figure as wide as every other."""
    return Figure(figsize=(WIDTH_IN, height_in), dpi=DPI, facecolor="white")


def place(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Axes at a place in inches from the upper left corner of the figure."""
    total = figure.get_size_inches()[1]
    x, y, w, h = left / WIDTH_IN, (total - top - height) / total, width / WIDTH_IN, height / total
    return figure.add_axes((x, y, w, h))


def headline(figure: Figure, title: str, line: str) -> None:
    """Title in bold and a quiet line of figures below it, at the upper left."""
    total = figure.get_size_inches()[1]
    x = 0.12 / WIDTH_IN
    figure.text(x, 1 - 0.12 / total, title, fontsize=13, fontweight="bold", va="top")
    figure.text(x, 1 - 0.42 / total, line, fontsize=9.5, color=QUIET, va="top")


def legend(figure: Figure, entries: Sequence[Artist]) -> None:
    """One legend for the whole figure, in rows at its lower edge."""
    figure.legend(
        handles=list(entries),
        loc="lower center",
        bbox_to_anchor=(0.5, 0.08 / figure.get_size_inches()[1]),
        ncols=legend_columns(entries),
        handlelength=1.5,
        handletextpad=0.6,
        columnspacing=1.5,
        borderaxespad=0.0,
        borderpad=0.0,
    )


def legend_columns(entries: Sequence[Artist]) -> int:
    """How many entries fit side by side: column by column, as the legend fills them."""
    widths = [0.42 + 0.073 * len(str(entry.get_label())) for entry in entries]
    for rows in range(1, len(widths) + 1):
        columns = [widths[i : i + rows] for i in range(0, len(widths), rows)]
        if sum(map(max, columns)) <= WIDTH_IN - 0.2:
            return len(columns)
    return 1


def legend_height_in(entries: Sequence[Artist]) -> float:
    """Room that `legend` takes at the lower edge."""
    return 0.14 + 0.19 * float(np.ceil(len(entries) / legend_columns(entries)))


def agent_entries(colours: Mapping[str, str]) -> list[Artist]:
    """The legend's entries of the agents."""
    return [
        Line2D([], [], color=colour, linewidth=2.4, label=agent)
        for agent, colour in colours.items()
    ]


def halo(width: float = 3.0) -> list[Stroke]:
    """White edge that keeps text readable on top of lines."""
    return [withStroke(linewidth=width, foreground="white")]


def save(figure: Figure, file: Path) -> None:
    """Write a PNG with a palette of 256 colours; the same figure gives the same bytes."""
    buffer, (width, height) = FigureCanvasAgg(figure).print_to_buffer()  # type: ignore[no-untyped-call]
    pixels = np.frombuffer(buffer, np.uint8).reshape(height, width, 4).astype(np.uint32)
    packed = pixels[..., 0] << 16 | pixels[..., 1] << 8 | pixels[..., 2]
    colours, inverse, counts = np.unique(packed, return_inverse=True, return_counts=True)
    palette, nearest = _palette(colours, counts)
    picture = Image.fromarray(nearest[inverse].reshape(packed.shape), mode="P")
    picture.putpalette(palette.tobytes())
    picture.save(file, format="PNG", optimize=True, dpi=(DPI, DPI))


def _palette(
    packed: NDArray[np.uint32], counts: NDArray[np.int64]
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """A palette (P, 3) for packed colours (U,), and the entry (U,) that is nearest to each.

    The style's own colours are in it, pure and half faded, so that a single wrong loop stays red;
    then the most frequent ones as they are; the remaining entries are spread over all others.
    """
    colours = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=1).astype(np.uint8)
    order = np.argsort(-counts, kind="stable")
    own = np.array([to_rgb(name) for name in (*AGENT_COLOURS, WRONG, INTER, INTRA)])
    pure = np.concatenate([own, (own + 1) / 2]) * 255
    palette = np.concatenate([np.round(pure).astype(np.uint8), colours[order[:_EXACT_COLOURS]]])
    rest = colours[order[_EXACT_COLOURS:]]
    if len(rest):
        mixed = Image.fromarray(rest[None]).quantize(256 - len(palette), Image.Quantize.MEDIANCUT)
        spread = np.array(mixed.getpalette(), dtype=np.uint8).reshape(-1, 3)
        palette = np.concatenate([palette, spread[: 256 - len(palette)]])
    difference = colours[:, None].astype(np.int32) - palette[None].astype(np.int32)
    nearest = (difference**2).sum(axis=-1).argmin(axis=1)
    return palette, nearest.astype(np.uint8)
