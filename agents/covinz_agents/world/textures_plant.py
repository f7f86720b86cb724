"""Textures of a machine hall: walls, floor, machines, tanks, crates, switches, pipes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from covinz_agents.world.masonry import courses, lettering, rectangle, weather
from covinz_agents.world.noise import Colour, Field, Patch, blend, blotches, fractal, grain, shade


def _enamel(patch: Patch) -> Colour:
    """A colour of machines."""
    return patch.pick(
        (95, 120, 70),
        (130, 110, 60),
        (60, 110, 170),
        (140, 140, 145),
        (50, 60, 150),
        (150, 100, 50),
    )


def _code(patch: Patch) -> str:
    letters = "".join(patch.rng.choice(list("ABCDEFGHKLMNPRSTVX"), 2))
    return f"{letters}-{patch.rng.integers(10, 999)}"


def _wall(patch: Patch) -> Field:
    """Painted blocks, darker below, with stains, cables and marks."""
    image = patch.flat(patch.pick((165, 178, 180), (150, 165, 160), (175, 180, 185)))
    courses(patch, image, 0.5, 0.25, joint=(115, 120, 122), joint_m=0.012, spread=0.05)
    weather(patch, image, 0.12)
    blend(image, (105, 120, 130), 0.7 * blotches(patch, 0.9, 0.06))
    blend(image, (90, 95, 98), blotches(patch, 0.25, 0.02, 0.15))
    for _ in range(int(patch.width_m / 1.3)):
        x = float(patch.rng.uniform(0, patch.width_m))
        rectangle(
            patch, image, (x, 0), (0.04, patch.height_m), patch.pick((60, 62, 65), (190, 192, 190))
        )
    for _ in range(int(patch.width_m / 1.2)):
        at = patch.rng.uniform(0.1, 0.9, 2) * [patch.width_m, patch.height_m]
        size = patch.rng.uniform([0.15, 0.2], [0.45, 0.6])
        rectangle(patch, image, (at[0], at[1]), (size[0], size[1]), _enamel(patch))
        rectangle(patch, image, (at[0] + 0.04, at[1] + 0.05), (0.1, 0.06), (225, 225, 225))
    place = (float(patch.rng.uniform(0.1, max(0.2, patch.width_m - 1.5))), 0.6 * patch.height_m)
    lettering(patch, image, _code(patch), place, 0.3, patch.pick((60, 60, 160), (50, 50, 50)))
    return image


def _floor(patch: Patch) -> Field:
    """Concrete with joints, tyre marks, oil and painted lines."""
    image = patch.flat(patch.pick((128, 132, 134), (118, 124, 126)))
    shade(image, 0.12 * fractal(patch, 2.5, 0.03))
    blend(image, (60, 62, 66), 0.7 * blotches(patch, 0.5, 0.05))
    blend(image, (160, 165, 168), 0.5 * blotches(patch, 0.3, 0.03))
    for _ in range(int(patch.rng.integers(1, 4))):
        _curve(patch, image, (70, 72, 74), 0.06)
    if patch.rng.random() < 0.6:
        x = float(patch.rng.uniform(0.3, patch.width_m - 0.3))
        rectangle(patch, image, (x, 0), (0.1, patch.height_m), (50, 170, 205))
    at = patch.rng.uniform(0.1, 0.6, 2) * [patch.width_m, patch.height_m] + [0, 0.4]
    lettering(patch, image, _code(patch), (at[0], at[1]), 0.3, (205, 210, 212))
    shade(image, 0.06 * grain(patch))
    return image


def _curve(patch: Patch, image: Field, bgr: Colour, width_m: float) -> None:
    angle = patch.rng.uniform(0, 2 * np.pi) + np.cumsum(patch.rng.normal(0, 0.12, 40))
    start = patch.rng.uniform(0, 1, 2) * [patch.width_px, patch.height_px]
    steps = 0.1 * patch.px_per_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.rint(start + np.cumsum(steps, axis=0)).astype(np.int32)
    width = max(1, round(width_m * patch.px_per_m))
    cv2.polylines(image, [points], False, bgr, width, cv2.LINE_AA)


def _ceiling(patch: Patch) -> Field:
    image = patch.flat((150, 152, 152))
    for x in np.arange(0, patch.width_m, 0.35):
        rectangle(patch, image, (float(x), 0), (0.06, patch.height_m), (95, 97, 98))
    shade(image, 0.15 * fractal(patch, 1.5, 0.05))
    blend(image, (80, 95, 110), 0.6 * blotches(patch, 0.7, 0.08))
    if patch.rng.random() < 0.5:
        at = patch.rng.uniform(0.2, 0.6, 2) * [patch.width_m, patch.height_m]
        rectangle(patch, image, (at[0], at[1]), (1.4, 0.25), (245, 250, 250))
    return image


def _machine(patch: Patch) -> Field:
    """Enamelled sheets with bolts, slits, plates, dials and wear."""
    image = patch.flat(_enamel(patch))
    shade(image, 0.10 * fractal(patch, 0.8, 0.03))
    size = float(patch.rng.uniform(0.5, 0.9)), float(patch.rng.uniform(0.4, 0.8))
    courses(patch, image, *size, joint=(45, 48, 50), joint_m=0.015, spread=0.06)
    for _ in range(max(2, int(5 * patch.width_m * patch.height_m))):
        _fitting(patch, image)
    blend(image, (70, 85, 120), 0.6 * blotches(patch, 0.25, 0.05, 0.15))
    shade(image, 0.04 * grain(patch))
    return image


def _fitting(patch: Patch, image: Field) -> None:
    """A dial, a row of slits, a plate or a lever."""
    at = patch.rng.uniform(0.05, 0.9, 2) * [patch.width_m, patch.height_m]
    x, y = float(at[0]), float(at[1])
    kind = patch.rng.random()
    if kind < 0.3:
        center = round(x * patch.x_px_per_m), round(y * patch.y_px_per_m)
        radius = float(patch.rng.uniform(0.04, 0.11)) * patch.px_per_m
        cv2.circle(image, center, max(1, round(radius)), (60, 60, 62), -1, cv2.LINE_AA)
        cv2.circle(image, center, max(1, round(0.75 * radius)), (225, 228, 228), -1, cv2.LINE_AA)
        turn = patch.rng.uniform(0, 2 * np.pi)
        tip = round(center[0] + radius * np.cos(turn)), round(center[1] + radius * np.sin(turn))
        cv2.line(image, center, tip, (30, 30, 180), 1, cv2.LINE_AA)
    elif kind < 0.6:
        for k in range(int(patch.rng.integers(3, 7))):
            rectangle(patch, image, (x, y + 0.05 * k), (0.3, 0.02), (30, 32, 34))
    elif kind < 0.85:
        rectangle(patch, image, (x, y), (0.28, 0.14), patch.pick((220, 225, 225), (40, 190, 220)))
        lettering(patch, image, _code(patch)[:4], (x + 0.03, y + 0.11), 0.07, (40, 40, 45))
    else:
        rectangle(patch, image, (x, y), (0.06, 0.25), (40, 40, 190))


def _switches(patch: Patch) -> Field:
    """Doors of a cabinet with meters, lamps and a warning."""
    image = patch.flat(patch.pick((165, 170, 165), (150, 160, 170), (110, 130, 120)))
    shade(image, 0.06 * fractal(patch, 0.6, 0.03))
    courses(patch, image, 0.45, 0.75, joint=(60, 62, 65), joint_m=0.012, spread=0.05, shift=0.0)
    for _ in range(max(4, int(14 * patch.width_m * patch.height_m))):
        at = patch.rng.uniform(0.03, 0.92, 2) * [patch.width_m, patch.height_m]
        size = float(patch.rng.uniform(0.03, 0.12)), float(patch.rng.uniform(0.03, 0.1))
        tone = patch.pick(
            (40, 40, 190), (60, 170, 60), (30, 190, 220), (35, 35, 38), (225, 225, 225)
        )
        rectangle(patch, image, (at[0], at[1]), size, tone)
    _fitting(patch, image)
    return image


def _tank(patch: Patch) -> Field:
    """Riveted plates with rust, a level mark and a number."""
    image = patch.flat(patch.pick((140, 145, 148), (100, 120, 150), (160, 150, 130), (90, 110, 90)))
    courses(patch, image, 5.0, 0.9, joint=(70, 72, 75), joint_m=0.02, spread=0.08)
    for y in np.arange(0.08, patch.height_m, 0.9):
        for x in np.arange(0.05, patch.width_m, 0.12):
            rectangle(patch, image, (float(x), float(y)), (0.03, 0.03), (75, 78, 80))
    weather(patch, image, 0.18)
    blend(image, (50, 80, 140), 0.8 * blotches(patch, 0.4, 0.08))
    if patch.rng.random() < 0.4:
        at = (0.05, float(patch.rng.uniform(0.3, 0.8)) * patch.height_m)
        lettering(patch, image, str(patch.rng.integers(10, 99)), at, 0.3, (230, 232, 232))
    return image


def _crate(patch: Patch) -> Field:
    """Boards or cardboard with stamps and labels."""
    if patch.rng.random() < 0.5:
        image = patch.flat(patch.pick((95, 140, 180), (80, 120, 160), (110, 150, 185)))
        courses(patch, image, 2.0, 0.13, joint=(35, 50, 70), joint_m=0.012, spread=0.10)
        shade(image, 0.12 * fractal(patch, 0.08, 0.02, stretch=0.12))
        for x in (0.0, patch.width_m - 0.1):
            rectangle(patch, image, (x, 0), (0.1, patch.height_m), (70, 105, 140))
    else:
        image = patch.flat(
            patch.pick((110, 150, 185), (150, 120, 60), (60, 110, 60), (170, 172, 175))
        )
        shade(image, 0.08 * fractal(patch, 0.4, 0.03))
        rectangle(patch, image, (0.44 * patch.width_m, 0), (0.06, patch.height_m), (165, 185, 200))
    ink = patch.pick((40, 40, 45), (40, 40, 160), (220, 225, 225))
    high_m = float(patch.rng.uniform(0.12, 0.22)) * patch.height_m
    at = 0.1 * patch.width_m, float(patch.rng.uniform(0.4, 0.8)) * patch.height_m
    lettering(patch, image, _code(patch), at, min(high_m, 0.16 * patch.width_m), ink)
    spot = patch.rng.uniform(0.05, 0.6, 2) * [patch.width_m, patch.height_m]
    rectangle(patch, image, (spot[0], spot[1]), (0.2, 0.14), (228, 230, 230))
    rectangle(patch, image, (spot[0] + 0.02, spot[1] + 0.08), (0.14, 0.03), (40, 40, 45))
    return image


def _steel(patch: Patch) -> Field:
    image = patch.flat(patch.pick((150, 110, 50), (55, 85, 175), (120, 125, 128)))
    shade(image, 0.12 * fractal(patch, 0.5, 0.03))
    for x in np.arange(0.05, patch.width_m, 0.15):
        for y in np.arange(0.03, patch.height_m, 0.15):
            rectangle(patch, image, (float(x), float(y)), (0.025, 0.025), (40, 42, 44))
    return image


def _girder(patch: Patch) -> Field:
    image = patch.flat(patch.pick((50, 150, 190), (90, 100, 105)))
    shade(image, 0.15 * fractal(patch, 1.0, 0.05))
    for x in np.arange(0.2, patch.width_m, 0.6):
        rectangle(patch, image, (float(x), 0.02), (0.04, 0.9 * patch.height_m), (60, 65, 70))
    blend(image, (60, 75, 110), 0.7 * blotches(patch, 0.4, 0.1))
    return image


def _pipe(patch: Patch) -> Field:
    image = patch.flat(patch.pick((150, 152, 155), (60, 130, 70), (150, 110, 50), (50, 60, 160)))
    shade(image, 0.12 * fractal(patch, 0.8, 0.04))
    along = patch.width_m > patch.height_m
    for at in np.arange(float(patch.rng.uniform(0, 0.5)), max(patch.width_m, patch.height_m), 1.1):
        low, size = ((float(at), 0.0), (0.08, patch.height_m))
        if not along:
            low, size = (0.0, float(at)), (patch.width_m, 0.08)
        rectangle(
            patch, image, low, size, patch.pick((70, 72, 75), (220, 222, 222), (40, 190, 215))
        )
    blend(image, (60, 80, 115), 0.6 * blotches(patch, 0.3, 0.08))
    return image


def _hazard(patch: Patch) -> Field:
    """Yellow and black stripes, scratched."""
    x = np.arange(patch.width_px)[None] / patch.x_px_per_m
    y = np.arange(patch.height_px)[:, None] / patch.y_px_per_m
    image = patch.flat((40, 180, 215))
    blend(image, (35, 35, 38), ((x + y) % 0.3 < 0.15).astype(np.float32))
    blend(image, (135, 140, 142), 0.8 * blotches(patch, 0.2, 0.12, 0.15))
    return image


def _window(patch: Patch) -> Field:
    image = patch.flat((225, 222, 212))
    shade(image, 0.10 * fractal(patch, 0.8, 0.05))
    for x in np.arange(0, patch.width_m, 0.6):
        rectangle(patch, image, (float(x), 0), (0.05, patch.height_m), (85, 88, 90))
    for y in (0.0, 0.45, 0.9, patch.height_m - 0.06):
        rectangle(patch, image, (0, y), (patch.width_m, 0.05), (85, 88, 90))
    return image


def _poster(patch: Patch) -> Field:
    image = patch.flat(patch.pick((225, 228, 228), (60, 180, 215), (140, 90, 40), (60, 130, 60)))
    for _ in range(8):
        at = patch.rng.uniform(0.03, 0.8, 2) * [patch.width_m, patch.height_m]
        size = patch.rng.uniform(0.05, 0.4, 2)
        rectangle(patch, image, (at[0], at[1]), (size[0], size[1]), _enamel(patch))
    for k in range(3):
        at_m = 0.1, (0.3 + 0.28 * k) * patch.height_m
        text = _code(patch) + " " + _code(patch)
        lettering(patch, image, text, at_m, 0.12 * patch.height_m, (30, 32, 35))
    return image


MATERIALS: Mapping[str, Callable[[Patch], Field]] = {
    "wall": _wall, "floor": _floor, "ceiling": _ceiling, "machine": _machine,
    "switches": _switches, "tank": _tank, "crate": _crate, "steel": _steel, "girder": _girder,
    "pipe": _pipe, "hazard": _hazard, "window": _window, "poster": _poster,
}  # fmt: skip
