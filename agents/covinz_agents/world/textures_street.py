"""Textures of streets and gardens: pavements, plants, walls, vans, benches."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from covinz_agents.world.masonry import courses, leaves, lettering, rectangle, weather
from covinz_agents.world.noise import Colour, Field, Patch, blend, blotches, fractal, grain, shade


def _asphalt(patch: Patch) -> Field:
    """Mended and cracked, with stains and lids."""
    image = patch.flat(patch.pick((92, 93, 95), (80, 82, 85), (100, 100, 98)))
    shade(image, 0.10 * fractal(patch, 3.0, 0.08))
    for _ in range(int(patch.rng.integers(1, 4))):
        size = patch.rng.uniform(0.8, 4.0, 2)
        at = patch.rng.uniform(0, 1, 2) * [patch.width_m, patch.height_m]
        tone = float(patch.rng.uniform(55, 120))
        rectangle(patch, image, (at[0], at[1]), (size[0], size[1]), (tone, tone, tone))
    blend(image, (45, 45, 48), 0.7 * blotches(patch, 0.6, 0.05))
    blend(image, (150, 150, 148), 0.5 * blotches(patch, 0.3, 0.02))
    for _ in range(int(0.08 * patch.width_m * patch.height_m)):
        _crack(patch, image)
    for _ in range(int(patch.rng.integers(0, 3))):
        _lid(patch, image)
    shade(image, 0.09 * grain(patch))
    return image


def _crack(patch: Patch, image: Field) -> None:
    start = patch.rng.uniform(0, 1, 2) * [patch.width_px, patch.height_px]
    angle = patch.rng.uniform(0, 2 * np.pi) + np.cumsum(patch.rng.normal(0, 0.5, 12))
    steps = 0.25 * patch.px_per_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.rint(start + np.cumsum(steps, axis=0)).astype(np.int32)
    cv2.polylines(image, [points], False, (48, 48, 50), 1, cv2.LINE_AA)


def _lid(patch: Patch, image: Field) -> None:
    """A manhole: rings and spokes of iron."""
    at = patch.rng.uniform(0.1, 0.9, 2) * [patch.width_px, patch.height_px]
    center, radius = (int(at[0]), int(at[1])), 0.35 * patch.px_per_m
    cv2.circle(image, center, max(2, round(radius)), (55, 60, 68), -1, cv2.LINE_AA)
    for share in (0.95, 0.6, 0.3):
        cv2.circle(image, center, max(1, round(share * radius)), (130, 135, 140), 1, cv2.LINE_AA)


def _zebra(patch: Patch) -> Field:
    image = _asphalt(patch)
    worn = 0.9 - 0.5 * blotches(patch, 0.3, 0.25)
    rows = ((np.arange(patch.height_px) / patch.y_px_per_m) % 1.0 < 0.5).astype(np.float32)
    blend(image, (215, 218, 218), worn * rows[:, None])
    return image


def _paving(patch: Patch) -> Field:
    image = patch.flat(patch.pick((140, 150, 158), (150, 155, 155), (125, 140, 155)))
    size = float(patch.rng.choice([0.4, 0.5, 0.6]))
    courses(patch, image, size, size, joint=(75, 82, 85), joint_m=0.02, spread=0.10,
            shift=float(patch.rng.choice([0.0, 0.5])))  # fmt: skip
    shade(image, 0.10 * fractal(patch, 3.0, 0.06))
    blend(image, (70, 72, 75), 0.6 * blotches(patch, 0.4, 0.04))
    blend(image, (70, 105, 85), 0.6 * blotches(patch, 0.25, 0.03))
    for _ in range(int(0.04 * patch.width_m * patch.height_m)):
        _lid(patch, image)
    shade(image, 0.05 * grain(patch))
    return image


def _kerb(patch: Patch) -> Field:
    image = patch.flat((165, 170, 172))
    courses(patch, image, 1.0, 0.5, joint=(80, 85, 88), joint_m=0.03, spread=0.1)
    shade(image, 0.15 * fractal(patch, 1.0, 0.05))
    return image


def _grass(patch: Patch) -> Field:
    image = patch.flat((55, 120, 95))
    shade(image, 0.25 * fractal(patch, 3.0, 0.05))
    blend(image, (70, 130, 160), 0.6 * blotches(patch, 1.5, 0.12))
    blend(image, (40, 75, 60), 0.7 * blotches(patch, 0.3, 0.12))
    blend(image, patch.pick((210, 225, 230), (90, 200, 225)), blotches(patch, 0.12, 0.01, 0.1))
    shade(image, 0.12 * grain(patch))
    return image


def _hedge(patch: Patch) -> Field:
    image = leaves(patch, 0.10, (18, 38, 26), (75, 140, 95))
    shade(image, 0.2 * fractal(patch, 1.5, 0.2))
    return image


def _foliage(patch: Patch) -> Field:
    light: Colour = patch.pick((80, 165, 120), (60, 140, 150), (90, 150, 100))
    image = leaves(patch, 0.16, (16, 34, 24), light)
    shade(image, 0.3 * fractal(patch, 1.2, 0.3))
    return image


def _bark(patch: Patch) -> Field:
    image = patch.flat(patch.pick((60, 75, 90), (80, 90, 100), (95, 105, 108)))
    shade(image, 0.35 * fractal(patch, 0.12, 0.03, stretch=5.0))
    return image


def _garden_wall(patch: Patch) -> Field:
    image = patch.flat(patch.pick((80, 95, 150), (105, 125, 165), (120, 135, 145)))
    courses(patch, image, 0.26, 0.09, joint=(140, 148, 150), spread=0.16)
    weather(patch, image, 0.16)
    blend(image, (60, 100, 75), 0.7 * blotches(patch, 0.8, 0.07))
    if patch.width_m > 3.0:
        at = float(patch.rng.uniform(0.3, patch.width_m - 2.2)), 0.6 * patch.height_m
        text = "".join(patch.rng.choice(list("AEKMORSTVZ"), 4))
        lettering(
            patch, image, text, at, 0.45, patch.pick((190, 90, 40), (50, 60, 200), (230, 230, 230))
        )
    return image


def _wood(patch: Patch) -> Field:
    image = patch.flat(patch.pick((70, 105, 150), (60, 85, 120), (95, 125, 150)))
    courses(patch, image, 2.5, 0.14, joint=(30, 40, 55), joint_m=0.012, spread=0.12)
    shade(image, 0.10 * fractal(patch, 0.1, 0.02, stretch=0.1))
    return image


def _dark_metal(patch: Patch) -> Field:
    image = patch.flat((62, 66, 66))
    shade(image, 0.2 * fractal(patch, 0.4, 0.03))
    return image


def _van_paint(patch: Patch) -> Field:
    image = patch.flat((208, 210, 210))
    shade(image, 0.04 * fractal(patch, 1.0, 0.1))
    return image


def _van_side(patch: Patch) -> Field:
    """White, with a stripe, a name, a door and wheels."""
    image, colour = (
        _van_paint(patch),
        patch.pick((170, 80, 30), (40, 50, 180), (50, 120, 50), (30, 140, 220)),
    )
    wide, high = patch.width_m, patch.height_m
    stripe = float(patch.rng.uniform(0.45, 0.6)) * high
    rectangle(patch, image, (0, stripe), (wide, float(patch.rng.uniform(0.08, 0.3))), colour)
    text = "".join(patch.rng.choice(list("ABEGIKLMNORSTUVX"), int(patch.rng.integers(4, 8))))
    lettering(patch, image, text, (float(patch.rng.uniform(0.2, 1.0)), 0.38 * high), 0.32, colour)
    digits = (
        f"0{patch.rng.integers(10, 99)} {patch.rng.integers(100, 999)} {patch.rng.integers(10, 99)}"
    )
    lettering(patch, image, digits, (0.4, stripe + 0.45), 0.13, (60, 60, 65))
    for x in (1.2, 2.4):
        rectangle(patch, image, (x, 0.1), (0.025, high - 0.4), (95, 95, 98))
    for x in (0.55, wide - 0.7):
        center = round(x * patch.x_px_per_m), round((high - 0.16) * patch.y_px_per_m)
        for radius_m, tone in ((0.4, 35), (0.2, 150), (0.06, 60)):
            cv2.circle(
                image,
                center,
                max(1, round(radius_m * patch.px_per_m)),
                (tone,) * 3,
                -1,
                cv2.LINE_AA,
            )
    return image


def _van_end(patch: Patch) -> Field:
    """Lights, a plate and doors."""
    image, (wide, high) = _van_paint(patch), (patch.width_m, patch.height_m)
    rectangle(patch, image, (wide / 2 - 0.015, 0.05), (0.03, high), (80, 80, 84))
    for x in (0.05, wide - 0.25):
        rectangle(
            patch, image, (x, 0.55 * high), (0.2, 0.25), patch.pick((40, 40, 190), (235, 235, 230))
        )
    rectangle(patch, image, (wide / 2 - 0.28, high - 0.4), (0.56, 0.14), (230, 232, 232))
    digits = f"ZH {patch.rng.integers(1000, 99999)}"
    lettering(patch, image, digits, (wide / 2 - 0.24, high - 0.29), 0.09, (30, 30, 30))
    rectangle(patch, image, (0, high - 0.18), (wide, 0.18), (70, 72, 75))
    return image


def _windscreen(patch: Patch) -> Field:
    image = patch.flat((70, 62, 55))
    shade(image, 0.4 * fractal(patch, 1.0, 0.1))
    rectangle(patch, image, (0.2, patch.height_m - 0.15), (0.5, 0.1), (190, 195, 195))
    return image


MATERIALS: Mapping[str, Callable[[Patch], Field]] = {
    "asphalt": _asphalt, "zebra": _zebra, "paving": _paving, "kerb": _kerb, "grass": _grass,
    "hedge": _hedge, "foliage": _foliage, "bark": _bark, "garden_wall": _garden_wall,
    "wood": _wood, "dark_metal": _dark_metal, "van_side": _van_side, "van_end": _van_end,
    "van_roof": _van_paint, "windscreen": _windscreen,
}  # fmt: skip
