"""Textures of a hall itself: walls, floor, roof, gates, windows, lamps, notices."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from covinz_agents.world.masonry import courses, lettering, rectangle, weather
from covinz_agents.world.noise import (
    Colour,
    Field,
    Patch,
    blend,
    blotches,
    fractal,
    grain,
    mask,
    shade,
)

YELLOW: Colour = (40, 175, 215)
_WORDS = (
    "BAY", "GATE", "LINE", "CELL", "DOCK", "ZONE", "LIFT", "PRESS", "STORE", "PUMP", "SHOP", "TEST",
)  # fmt: skip
_NOTICES = (
    "DANGER", "HIGH VOLTAGE", "NO ENTRY", "EXIT", "WEAR HELMET", "SAFETY FIRST", "FIRST AID",
    "KEEP CLEAR", "MAX 12 t", "HOT SURFACE", "EYE WASH", "FIRE POINT", "LASER", "SHIFT PLAN",
)  # fmt: skip


def word(patch: Patch) -> str:
    """Something that is written on things in halls."""
    return f"{_WORDS[int(patch.rng.integers(len(_WORDS)))]} {patch.rng.integers(1, 99)}"


def scratches(patch: Patch, image: Field, per_m2: float, bgr: Colour, longest_m: float) -> None:
    """Thin lines in all directions."""
    drawn = mask(patch)
    for _ in range(int(patch.rng.poisson(per_m2 * patch.width_m * patch.height_m))):
        start = patch.rng.uniform(0, 1, 2) * [patch.width_px, patch.height_px]
        angle = patch.rng.uniform(0, 2 * np.pi)
        length = patch.rng.uniform(0.1, 1.0) * longest_m * patch.px_per_m
        end = start + length * np.array([np.cos(angle), np.sin(angle)])
        ends = [(int(p[0]), int(p[1])) for p in (start, end)]
        cv2.line(drawn, ends[0], ends[1], int(patch.rng.integers(90, 255)), 1, cv2.LINE_AA)
    blend(image, bgr, drawn.astype(np.float32) / 255)


def dots(patch: Patch, image: Field, spacing_m: float, radius_m: float, edge_m: float) -> None:
    """Bolts along the edges and, if it is far enough, the middle: dark below, light above."""
    radius = max(1, round(radius_m * patch.px_per_m))
    for y in _stations(patch.height_m, spacing_m, edge_m):
        for x in _stations(patch.width_m, spacing_m, edge_m):
            at = round(x * patch.x_px_per_m), round(y * patch.y_px_per_m)
            cv2.circle(image, (at[0], at[1] + 1), radius + 1, (45, 48, 50), -1, cv2.LINE_AA)
            cv2.circle(image, at, radius, (190, 192, 195), -1, cv2.LINE_AA)


def _stations(length_m: float, spacing_m: float, edge_m: float) -> list[float]:
    number = max(2, 1 + round((length_m - 2 * edge_m) / spacing_m))
    return [float(at) for at in np.linspace(edge_m, length_m - edge_m, number)]


def frame(patch: Patch, image: Field, width_m: float, bgr: Colour) -> None:
    """A border around the whole patch."""
    rectangle(patch, image, (0, 0), (patch.width_m, width_m), bgr)
    rectangle(patch, image, (0, patch.height_m - width_m), (patch.width_m, width_m), bgr)
    rectangle(patch, image, (0, 0), (width_m, patch.height_m), bgr)
    rectangle(patch, image, (patch.width_m - width_m, 0), (width_m, patch.height_m), bgr)


def _concrete(patch: Patch) -> Field:
    image = patch.flat((163, 167, 170))
    shade(image, 0.09 * fractal(patch, 2.5, 0.02))
    shade(image, -0.16 * blotches(patch, 0.5, 0.12) + 0.12 * blotches(patch, 0.25, 0.08))
    blend(image, (70, 74, 78), 0.8 * blotches(patch, 0.09, 0.025, 0.2))
    scratches(patch, image, 2.0, (95, 98, 100), 0.6)
    shade(image, 0.045 * grain(patch))
    return image


def _wall(patch: Patch) -> Field:
    """A precast panel: joints at its edges, holes of the formwork, stains, writing, boxes."""
    image = _concrete(patch)
    shade(
        image, np.float32(patch.rng.normal(0, 0.05)) + 0.07 * fractal(patch, 1.2, 0.05, stretch=6)
    )
    weather(patch, image, 0.05)
    for x in _stations(patch.width_m, 1.1, 0.4):
        for y in _stations(patch.height_m, 1.1, 0.4):
            at = round(x * patch.x_px_per_m), round(y * patch.y_px_per_m)
            cv2.circle(
                image, at, max(1, round(0.03 * patch.px_per_m)), (75, 78, 80), -1, cv2.LINE_AA
            )
    _fittings(patch, image)
    frame(patch, image, 0.025, (88, 92, 95))
    return image


def _fittings(patch: Patch, image: Field) -> None:
    """Conduits, boxes, patches of filler and stencilled names."""
    for _ in range(int(patch.rng.integers(0, 3))):
        x = float(patch.rng.uniform(0.1, 0.9)) * patch.width_m
        tone = float(patch.rng.uniform(90, 190))
        rectangle(patch, image, (x + 0.03, 0), (0.02, patch.height_m), (85, 88, 90))
        rectangle(patch, image, (x, 0), (0.035, patch.height_m), (tone, tone, tone))
        box = patch.rng.uniform(0.15, 0.45, 2)
        y = float(patch.rng.uniform(0.2, 0.8)) * patch.height_m
        rectangle(patch, image, (x - box[0] / 2 + 0.02, y + 0.02), (box[0], box[1]), (80, 82, 85))
        tone += float(patch.rng.uniform(-30, 30))
        rectangle(patch, image, (x - box[0] / 2, y), (box[0], box[1]), (tone, tone, tone * 0.97))
    for _ in range(int(patch.rng.integers(1, 4))):
        size = patch.rng.uniform(0.2, 0.9, 2)
        at = patch.rng.uniform(0, 0.9, 2) * [patch.width_m, patch.height_m]
        tone = float(patch.rng.uniform(135, 200))
        rectangle(patch, image, (at[0], at[1]), (size[0], size[1]), (tone, tone, tone))
    if patch.rng.random() < 0.5:
        at = patch.rng.uniform(0.15, 0.6, 2) * [patch.width_m, patch.height_m]
        colour = patch.pick((60, 62, 65), (50, 50, 150), (140, 80, 40))
        lettering(
            patch, image, word(patch), (at[0], at[1]), float(patch.rng.uniform(0.15, 0.4)), colour
        )


def _brick_wall(patch: Patch) -> Field:
    image = patch.flat(patch.pick((95, 110, 160), (90, 105, 150), (100, 115, 165)))
    courses(patch, image, 0.25, 0.08, joint=(155, 162, 166), joint_m=0.012, spread=0.13)
    weather(patch, image, 0.10)
    blend(image, (190, 195, 198), 0.5 * blotches(patch, 0.5, 0.06))
    _fittings(patch, image)
    return image


def _cladding(patch: Patch) -> Field:
    """Corrugated sheet in overlapping courses, with rust from its screws."""
    image = patch.flat((160, 158, 150))
    x = np.arange(patch.width_px) / patch.x_px_per_m
    rib = np.clip(4 * np.abs((x / 0.25) % 1 - 0.5) - 0.6, -0.6, 0.6).astype(np.float32)
    shade(image, 0.16 * rib[None])
    shade(image, 0.06 * fractal(patch, 2.0, 0.03, stretch=3))
    rust = np.clip(fractal(patch, 0.5, 0.04, stretch=6) - 0.9, 0, 1)
    blend(image, (60, 85, 130), 0.5 * rust)
    for y in np.arange(float(patch.rng.uniform(0.3, 1.0)), patch.height_m, 1.3):
        rectangle(patch, image, (0, float(y)), (patch.width_m, 0.02), (85, 85, 82))
        for k in np.arange(0.125, patch.width_m, 0.25):
            at = round(float(k) * patch.x_px_per_m), round((y - 0.05) * patch.y_px_per_m)
            cv2.circle(
                image, at, max(1, round(0.012 * patch.px_per_m)), (60, 65, 75), -1, cv2.LINE_AA
            )
    if patch.rng.random() < 0.4:
        _fittings(patch, image)
    shade(image, 0.03 * grain(patch))
    return image


def _floor(patch: Patch) -> Field:
    """Slabs with joints, oil, tyre marks, worn paint."""
    image = patch.flat((128, 134, 136))
    shade(image, np.float32(patch.rng.normal(0, 0.03)) + 0.12 * fractal(patch, 2.5, 0.02))
    blend(image, (60, 63, 68), 0.65 * blotches(patch, 0.7, 0.07))
    blend(image, (175, 178, 180), 0.45 * blotches(patch, 0.35, 0.07))
    blend(image, (48, 50, 53), 0.8 * blotches(patch, 0.12, 0.02, 0.2))
    for _ in range(int(patch.rng.integers(1, 4))):
        _tyre_mark(patch, image)
    if patch.rng.random() < 0.6:
        _floor_paint(patch, image)
    scratches(patch, image, 1.5, (190, 192, 194), 0.8)
    frame(patch, image, 0.012, (70, 73, 76))
    shade(image, 0.05 * grain(patch))
    return image


def _tyre_mark(patch: Patch, image: Field) -> None:
    drawn = mask(patch)
    turn = patch.rng.uniform(0, 2 * np.pi) + np.cumsum(patch.rng.normal(0, 0.06, 24))
    steps = 0.25 * patch.px_per_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    start = patch.rng.uniform(0, 1, 2) * [patch.width_px, patch.height_px]
    points = np.rint(start + np.cumsum(steps, axis=0)).astype(np.int32)
    cv2.polylines(drawn, [points], False, 255, max(1, round(0.12 * patch.px_per_m)), cv2.LINE_AA)
    worn = np.clip(0.5 + 0.4 * fractal(patch, 0.3, 0.02), 0, 1)
    blend(image, (62, 64, 66), 0.5 * worn * drawn.astype(np.float32) / 255)


def _floor_paint(patch: Patch, image: Field) -> None:
    """Hatched areas and bay names, half worn off."""
    painted = image.copy()
    colour = patch.pick(YELLOW, (205, 208, 210), (60, 60, 170))
    at = patch.rng.uniform(0.1, 0.5, 2) * [patch.width_m, patch.height_m]
    size = patch.rng.uniform(0.8, 1.8, 2)
    if patch.rng.random() < 0.5:
        for k in range(5):
            rectangle(patch, painted, (at[0] + k * 0.3, at[1]), (0.15, size[1]), colour)
    else:
        name = word(patch).replace(" ", "")
        lettering(patch, painted, name, (at[0], at[1] + 0.5), 0.45, colour)
        rectangle(patch, painted, (at[0] - 0.1, at[1] + 0.65), (size[0] + 0.4, 0.1), colour)
    worn = np.clip(0.85 - 0.5 * blotches(patch, 0.25, 0.3), 0, 1)
    image += (painted - image) * worn[..., None]


def _ceiling(patch: Patch) -> Field:
    """Trapezoidal sheets on purlins, dusty."""
    image = patch.flat((128, 130, 130))
    y = np.arange(patch.height_px) / patch.y_px_per_m
    rib = np.where((y / 0.28) % 1 < 0.5, 0.14, -0.14).astype(np.float32)
    shade(image, rib[:, None] + 0.10 * fractal(patch, 1.5, 0.05))
    blend(image, (70, 85, 105), 0.55 * blotches(patch, 0.6, 0.08))
    for x in np.arange(float(patch.rng.uniform(0.2, 0.9)), patch.width_m, 1.3):
        rectangle(patch, image, (float(x), 0), (0.16, patch.height_m), (95, 96, 98))
        rectangle(patch, image, (float(x), 0), (0.03, patch.height_m), (165, 168, 170))
    for _ in range(int(patch.rng.integers(1, 4))):
        at, size = patch.rng.uniform(0, 0.9, 2), patch.rng.uniform(0.2, 0.8, 2)
        low = at[0] * patch.width_m, at[1] * patch.height_m
        rectangle(patch, image, low, (size[0], size[1]), patch.pick((175, 178, 178), (60, 62, 65)))
    shade(image, 0.03 * grain(patch))
    return image


def _poster(patch: Patch) -> Field:
    """A notice: a head line on a coloured band, lines of small print, a picture."""
    paper = patch.pick((225, 228, 230), (205, 222, 230), (215, 215, 205), YELLOW)
    band = patch.pick((50, 50, 180), (150, 90, 40), (60, 130, 60), (35, 35, 38), (30, 120, 220))
    image = patch.flat(paper)
    wide, high = patch.width_m, patch.height_m
    rectangle(patch, image, (0, 0), (wide, 0.28 * high), band)
    text = _NOTICES[int(patch.rng.integers(len(_NOTICES)))]
    capital = min(0.15 * high, 0.78 * wide / len(text))
    lettering(patch, image, text, (0.05 * wide, 0.21 * high), capital, (235, 235, 235))
    for row in np.linspace(0.38, 0.9, int(patch.rng.integers(4, 8))):
        length = float(patch.rng.uniform(0.2, 0.5)) * wide
        rectangle(patch, image, (0.06 * wide, row * high), (length, 0.025 * high), (70, 72, 75))
    rectangle(patch, image, (0.62 * wide, 0.36 * high), (0.32 * wide, 0.5 * high), (60, 62, 66))
    for _ in range(6):
        at = patch.rng.uniform(0.64, 0.86) * wide, patch.rng.uniform(0.38, 0.74) * high
        size = patch.rng.uniform(0.03, 0.1, 2) * [wide, high]
        tone = patch.pick(YELLOW, (210, 210, 210), (90, 90, 210), (190, 140, 70))
        rectangle(patch, image, at, (size[0], size[1]), tone)
    lettering(patch, image, word(patch), (0.64 * wide, 0.95 * high), 0.05 * high, (60, 60, 60))
    frame(patch, image, 0.012, (50, 50, 52))
    shade(image, 0.07 * fractal(patch, 0.5, 0.02) + 0.02 * grain(patch))
    return image


def _window(patch: Patch) -> Field:
    """Panes against the sky, some dirty, one or two replaced."""
    image = patch.flat((235, 225, 215))
    columns, rows = max(2, round(patch.width_m / 0.5)), max(1, round(patch.height_m / 0.6))
    size = patch.width_m / columns, patch.height_m / rows
    for i in range(columns):
        for j in range(rows):
            tone = np.array([238, 228, 216]) * patch.rng.uniform(0.72, 1.0)
            rectangle(patch, image, (i * size[0], j * size[1]), size, tuple(tone.tolist()))
    shade(image, -0.12 * blotches(patch, 0.4, 0.3, 1.0) + 0.05 * fractal(patch, 1.0, 0.05))
    for i in range(columns + 1):
        rectangle(patch, image, (i * size[0] - 0.02, 0), (0.045, patch.height_m), (62, 66, 64))
    for j in range(rows + 1):
        rectangle(patch, image, (0, j * size[1] - 0.02), (patch.width_m, 0.045), (62, 66, 64))
    return image


def _lamp(patch: Patch) -> Field:
    image = patch.flat((250, 252, 254))
    frame(patch, image, 0.03, (90, 92, 95))
    for x in np.arange(0.2, patch.width_m, 0.2):
        rectangle(patch, image, (float(x), 0), (0.01, patch.height_m), (190, 192, 195))
    return image


def _gate(patch: Patch) -> Field:
    """A rolling gate: slats, a stripe of warning, a number."""
    image = patch.flat(patch.pick((150, 120, 80), (95, 130, 95), (165, 165, 160), (60, 110, 190)))
    y = np.arange(patch.height_px) / patch.y_px_per_m
    slat = (0.12 * np.sin(2 * np.pi * y / 0.18)).astype(np.float32)
    shade(image, slat[:, None] + 0.08 * fractal(patch, 1.2, 0.03))
    weather(patch, image, 0.08)
    place = 0.35 * patch.width_m, 0.5 * patch.height_m
    number = str(patch.rng.integers(1, 20))
    lettering(patch, image, number, place, 0.25 * patch.height_m, (228, 230, 232))
    scratches(patch, image, 3.0, (60, 62, 65), 0.8)
    frame(patch, image, 0.1, (70, 72, 75))
    return image


def _hazard(patch: Patch) -> Field:
    """Yellow and black stripes, worn."""
    image = patch.flat(YELLOW)
    x = np.arange(patch.width_px) / patch.x_px_per_m
    y = np.arange(patch.height_px) / patch.y_px_per_m
    inside_m = 0.075 - 0.3 * np.abs(((x[None] + y[:, None]) / 0.3) % 1 - 0.5)
    blend(image, (42, 44, 46), np.clip(0.5 + inside_m * patch.px_per_m, 0, 1))
    blend(image, (140, 144, 146), 0.85 * blotches(patch, 0.3, 0.14, 0.2))
    shade(image, 0.10 * fractal(patch, 0.8, 0.02) + 0.03 * grain(patch))
    return image


def _floor_line(patch: Patch) -> Field:
    image = patch.flat(YELLOW)
    blend(image, (120, 126, 128), 0.9 * blotches(patch, 0.3, 0.3, 0.3))
    shade(image, 0.10 * fractal(patch, 0.6, 0.02) + 0.03 * grain(patch))
    return image


MATERIALS: Mapping[str, Callable[[Patch], Field]] = {
    "concrete": _concrete, "wall": _wall, "brick_wall": _brick_wall, "cladding": _cladding,
    "floor": _floor, "ceiling": _ceiling, "poster": _poster, "window": _window, "lamp": _lamp,
    "gate": _gate, "hazard": _hazard, "floor_line": _floor_line,
}  # fmt: skip
