"""Textures of what stands in a hall: machines, cabinets, tanks, pipes, racks, goods."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from covinz_agents.world.masonry import lettering, rectangle
from covinz_agents.world.noise import Colour, Field, Patch, blend, blotches, fractal, grain, shade
from covinz_agents.world.textures_hall import YELLOW, dots, frame, scratches, word

_DARK: Colour = (58, 60, 63)


def _enamel(patch: Patch, bgr: Colour) -> Field:
    """Painted sheet metal with wear, oil and dust."""
    image = patch.flat(bgr)
    shade(image, np.float32(patch.rng.normal(0, 0.06)) + 0.09 * fractal(patch, 1.2, 0.02))
    blend(image, (70, 74, 78), 0.55 * blotches(patch, 0.35, 0.05))
    blend(image, (165, 168, 170), 0.7 * blotches(patch, 0.12, 0.025, 0.2))
    shade(image, 0.08 * fractal(patch, 0.25, 0.04, stretch=8))
    scratches(patch, image, 5.0, (175, 178, 180), 0.3)
    shade(image, 0.03 * grain(patch))
    return image


def _somewhere(patch: Patch, size_m: tuple[float, float]) -> tuple[float, float]:
    """Upper left corner of something of a size, well within the patch."""
    room = max(patch.width_m - size_m[0], 0.0), max(patch.height_m - size_m[1], 0.0)
    at = patch.rng.uniform(0.1, 0.9, 2) * room
    return float(at[0]), float(at[1])


def _vent(
    patch: Patch, image: Field, at_m: tuple[float, float], size_m: tuple[float, float]
) -> None:
    rectangle(patch, image, at_m, size_m, (95, 98, 100))
    for y in np.arange(at_m[1] + 0.02, at_m[1] + size_m[1] - 0.01, 0.04):
        rectangle(patch, image, (at_m[0] + 0.02, float(y)), (size_m[0] - 0.04, 0.018), (35, 37, 40))


def _plate(
    patch: Patch, image: Field, at_m: tuple[float, float], size_m: tuple[float, float]
) -> None:
    """A label with a name and small print."""
    paper = patch.pick((228, 230, 232), YELLOW, (190, 195, 200))
    rectangle(patch, image, at_m, size_m, paper)
    text = word(patch)
    high = min(0.3 * size_m[1], 0.85 * size_m[0] / len(text))
    foot = at_m[1] + 0.42 * size_m[1]
    lettering(patch, image, text, (at_m[0] + 0.06 * size_m[0], foot), high, (40, 40, 45))
    for row in (0.58, 0.72, 0.86):
        length = float(patch.rng.uniform(0.4, 0.85)) * size_m[0]
        at = at_m[0] + 0.06 * size_m[0], at_m[1] + row * size_m[1]
        rectangle(patch, image, at, (length, 0.05 * size_m[1]), (80, 82, 85))


def _dial(patch: Patch, image: Field, at_m: tuple[float, float], radius_m: float) -> None:
    center = round(at_m[0] * patch.x_px_per_m), round(at_m[1] * patch.y_px_per_m)
    radius = max(2, round(radius_m * patch.px_per_m))
    cv2.circle(image, center, radius, (45, 47, 50), -1, cv2.LINE_AA)
    cv2.circle(image, center, max(1, round(0.82 * radius)), (222, 225, 226), -1, cv2.LINE_AA)
    angle = float(patch.rng.uniform(0.8, 5.5))
    tip = (
        center[0] + round(0.7 * radius * np.sin(angle)),
        center[1] + round(0.7 * radius * np.cos(angle)),
    )
    cv2.line(image, center, tip, (40, 40, 170), max(1, radius // 8), cv2.LINE_AA)


def _machine(patch: Patch) -> Field:
    """A panel of a machine: a door with a seam, vents, labels, bolts, a stripe."""
    bgr = patch.pick(
        (120, 150, 95),
        (150, 125, 80),
        (170, 172, 168),
        (85, 130, 175),
        (110, 140, 120),
        (150, 105, 70),
    )
    image = _enamel(patch, bgr)
    wide, high = patch.width_m, patch.height_m
    if patch.rng.random() < 0.35:
        rectangle(
            patch, image, (0, 0.8 * high), (wide, 0.1 * high), patch.pick(YELLOW, (60, 60, 65))
        )
    door = float(patch.rng.uniform(0.3, 0.6)) * wide, 0.75 * high
    at = _somewhere(patch, door)
    for shift, tone in ((0.0, 45.0), (0.012, 200.0)):
        low = at[0] + shift, at[1] + shift
        corners = [round(v) for v in (low[0] * patch.x_px_per_m, low[1] * patch.y_px_per_m,
                                      (low[0] + door[0]) * patch.x_px_per_m,
                                      (low[1] + door[1]) * patch.y_px_per_m)]  # fmt: skip
        cv2.rectangle(image, corners[:2], corners[2:], (tone, tone, tone), 1)
    area = wide * high
    for _ in range(1 + int(patch.rng.poisson(0.7 * area))):
        size = float(patch.rng.uniform(0.15, 0.4)), float(patch.rng.uniform(0.12, 0.3))
        _vent(patch, image, _somewhere(patch, size), size)
    for _ in range(1 + int(patch.rng.poisson(1.2 * area))):
        size = float(patch.rng.uniform(0.12, 0.35)), float(patch.rng.uniform(0.08, 0.2))
        _plate(patch, image, _somewhere(patch, size), size)
    dots(patch, image, 0.3, 0.012, 0.05)
    frame(patch, image, 0.012, (70, 73, 76))
    return image


def _switches(patch: Patch) -> Field:
    """A front with doors, each with instruments, lamps, labels and a handle."""
    image = _enamel(
        patch, patch.pick((178, 180, 178), (150, 152, 150), (140, 120, 90), (125, 145, 120))
    )
    columns, rows = max(1, round(patch.width_m / 0.6)), max(1, round(patch.height_m / 0.7))
    size = patch.width_m / columns, patch.height_m / rows
    for i in range(columns):
        for j in range(rows):
            _bay(patch, image, (i * size[0], j * size[1]), size)
    return image


def _bay(patch: Patch, image: Field, low: tuple[float, float], size: tuple[float, float]) -> None:
    def at(x: float, y: float) -> tuple[float, float]:
        return low[0] + x * size[0], low[1] + y * size[1]

    rectangle(patch, image, low, (size[0], 0.01), _DARK)
    rectangle(patch, image, low, (0.01, size[1]), _DARK)
    kind = int(patch.rng.integers(4))
    if kind == 0:
        _vent(patch, image, at(0.15, 0.15), (0.7 * size[0], 0.35 * size[1]))
    elif kind == 1:
        for k in range(int(patch.rng.integers(2, 5))):
            _dial(patch, image, at(0.2 + 0.2 * k, 0.25), 0.09 * size[0])
    elif kind == 2:
        rectangle(patch, image, at(0.15, 0.12), (0.6 * size[0], 0.35 * size[1]), (50, 48, 40))
        for k in range(5):
            line, wide = at(0.19, 0.17 + 0.055 * k), float(patch.rng.uniform(0.1, 0.5)) * size[0]
            text = patch.pick((120, 210, 120), (200, 200, 120), (90, 160, 230))
            rectangle(patch, image, line, (wide, 0.02 * size[1]), text)
    else:
        _plate(patch, image, at(0.15, 0.12), (0.7 * size[0], 0.35 * size[1]))
    colours: tuple[Colour, ...] = (
        (60, 60, 210),
        (70, 170, 60),
        YELLOW,
        (225, 225, 225),
        (45, 45, 48),
    )
    for k in range(int(patch.rng.integers(2, 6))):
        place = at(0.15 + 0.15 * k, float(patch.rng.choice([0.6, 0.72])))
        center = round(place[0] * patch.x_px_per_m), round(place[1] * patch.y_px_per_m)
        radius = max(1, round(0.045 * size[0] * patch.px_per_m))
        cv2.circle(image, center, radius + 1, (40, 42, 45), -1, cv2.LINE_AA)
        cv2.circle(image, center, radius, patch.pick(*colours), -1, cv2.LINE_AA)
    rectangle(patch, image, at(0.88, 0.55), (0.05 * size[0], 0.25 * size[1]), _DARK)
    if patch.rng.random() < 0.6:
        _plate(patch, image, at(0.2, 0.82), (0.5 * size[0], 0.14 * size[1]))


def _tank(patch: Patch) -> Field:
    """Steel plates with welds, rust that runs down, a name."""
    image = patch.flat(
        patch.pick((178, 180, 178), (140, 150, 160), (160, 140, 110), (200, 205, 205))
    )
    shade(image, 0.12 * fractal(patch, 1.5, 0.02) + 0.1 * fractal(patch, 0.4, 0.05, stretch=8))
    blend(image, (55, 85, 135), 0.7 * blotches(patch, 0.3, 0.08))
    run = np.clip(fractal(patch, 0.3, 0.04, stretch=10) - 1.0, 0, 1)
    blend(image, (50, 75, 115), 0.6 * run)
    for y in np.arange(0.4, patch.height_m, 0.9):
        rectangle(patch, image, (0, float(y)), (patch.width_m, 0.02), (105, 108, 110))
        for x in np.arange(0.06, patch.width_m, 0.12):
            at = round(float(x) * patch.x_px_per_m), round((y + 0.07) * patch.y_px_per_m)
            cv2.circle(
                image, at, max(1, round(0.012 * patch.px_per_m)), (80, 84, 88), -1, cv2.LINE_AA
            )
    size = min(0.5, 0.9 * patch.width_m), min(0.35, 0.9 * patch.height_m)
    _plate(patch, image, _somewhere(patch, size), size)
    shade(image, 0.04 * grain(patch))
    return image


def _pipe(patch: Patch) -> Field:
    """Painted pipe with flanges, bands of colour and dirt; its length may run either way."""
    image = _enamel(
        patch, patch.pick((165, 170, 172), (90, 150, 95), (70, 130, 190), (175, 130, 80))
    )
    along_x = patch.width_m > patch.height_m
    length = max(patch.width_m, patch.height_m)
    for at in np.arange(
        float(patch.rng.uniform(0.2, 0.8)), length, float(patch.rng.uniform(0.8, 1.6))
    ):
        for shift, wide, bgr in (
            (0.0, 0.1, _DARK),
            (0.025, 0.05, patch.pick(YELLOW, (185, 188, 190))),
        ):
            low, size = (float(at) + shift, 0.0), (wide, patch.height_m)
            if not along_x:
                low, size = (low[1], low[0]), (patch.width_m, wide)
            rectangle(patch, image, low, size, bgr)
    return image


def _crate(patch: Patch) -> Field:
    """Goods: a carton, a wooden crate or a plastic box."""
    kind = patch.rng.random()
    image = _carton(patch) if kind < 0.5 else _wooden(patch) if kind < 0.8 else _plastic(patch)
    shade(image, 0.03 * grain(patch))
    return image


def _carton(patch: Patch) -> Field:
    image = patch.flat(patch.pick((110, 150, 185), (95, 135, 170), (125, 165, 195)))
    shade(image, 0.07 * fractal(patch, 0.6, 0.02) - 0.15 * blotches(patch, 0.2, 0.06))
    tape = 0.45 * patch.width_m, 0.06
    rectangle(patch, image, (tape[0], 0), (tape[1], patch.height_m), (140, 180, 205))
    for _ in range(int(patch.rng.integers(1, 4))):
        size = float(patch.rng.uniform(0.2, 0.45)) * patch.width_m, 0.28 * patch.height_m
        _plate(patch, image, _somewhere(patch, size), size)
    place = 0.08 * patch.width_m, 0.93 * patch.height_m
    high = min(0.13 * patch.height_m, 0.095 * patch.width_m)
    lettering(patch, image, word(patch), place, high, (45, 55, 70))
    frame(patch, image, 0.008, (75, 100, 125))
    return image


def _wooden(patch: Patch) -> Field:
    image = patch.flat(patch.pick((120, 165, 200), (95, 140, 178)))
    y = (np.arange(patch.height_px) / patch.y_px_per_m / 0.12).astype(np.intp)
    board = patch.rng.normal(0, 0.09, int(y.max()) + 1).astype(np.float32)
    shade(image, board[y][:, None] + 0.11 * fractal(patch, 0.6, 0.01, stretch=0.12))
    for k in range(int(y.max()) + 1):
        rectangle(patch, image, (0, 0.12 * k), (patch.width_m, 0.012), (48, 62, 78))
    for x in (0.03, patch.width_m - 0.13):
        rectangle(patch, image, (x, 0), (0.1, patch.height_m), (85, 125, 160))
    dots(patch, image, 0.12, 0.008, 0.06)
    high = 0.2 * patch.height_m
    lettering(
        patch, image, word(patch), (0.22 * patch.width_m, 0.6 * patch.height_m), high, (50, 52, 60)
    )
    return image


def _plastic(patch: Patch) -> Field:
    image = patch.flat(
        patch.pick((170, 90, 40), (50, 50, 175), (60, 150, 80), (65, 68, 72), YELLOW)
    )
    shade(image, 0.07 * fractal(patch, 0.5, 0.02))
    for x in np.arange(0.08, patch.width_m, 0.16):
        rectangle(patch, image, (float(x), 0), (0.02, patch.height_m), _DARK)
    size = 0.35 * patch.width_m, 0.1 * patch.height_m
    rectangle(patch, image, (0.32 * patch.width_m, 0.12 * patch.height_m), size, (35, 36, 38))
    size = 0.5 * patch.width_m, 0.32 * patch.height_m
    _plate(patch, image, _somewhere(patch, size), size)
    frame(patch, image, 0.02, _DARK)
    scratches(patch, image, 10.0, (200, 200, 200), 0.15)
    return image


def _steel(patch: Patch) -> Field:
    """Profiles of racks: painted, with rows of slots."""
    image = _enamel(
        patch, patch.pick((150, 95, 50), (45, 110, 215), (140, 142, 145), (110, 112, 115))
    )
    along_x = patch.width_m > patch.height_m
    length, across = max(patch.width_m, patch.height_m), min(patch.width_m, patch.height_m)
    for at in np.arange(0.06, length, 0.15):
        low, size = (float(at), 0.4 * across), (0.05, 0.2 * across)
        if not along_x:
            low, size = (low[1], low[0]), (size[1], size[0])
        rectangle(patch, image, low, size, (38, 40, 43))
    return image


def _girder(patch: Patch) -> Field:
    """A painted beam with stiffeners and rivets, and its load written on it."""
    image = _enamel(patch, patch.pick((60, 150, 200), (140, 145, 140), (150, 120, 85)))
    for x in np.arange(0.5, patch.width_m, 1.2):
        rectangle(patch, image, (float(x), 0), (0.05, patch.height_m), (85, 88, 90))
    dots(patch, image, 0.25, 0.015, min(0.05, 0.2 * patch.height_m))
    if patch.height_m > 0.2:
        high = min(0.45 * patch.height_m, 0.06 * patch.width_m)
        place = 0.3 * patch.width_m, 0.7 * patch.height_m
        lettering(patch, image, f"SWL {patch.rng.integers(2, 20)} t", place, high, (40, 42, 45))
    return image


MATERIALS: Mapping[str, Callable[[Patch], Field]] = {
    "machine": _machine, "switches": _switches, "tank": _tank, "pipe": _pipe, "crate": _crate,
    "steel": _steel, "girder": _girder,
}  # fmt: skip
