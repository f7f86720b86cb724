"""Textures of houses: fronts with windows, doors, shop windows, balconies, roofs, signs."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from covinz_agents.world.facades import STOREY_M
from covinz_agents.world.masonry import courses, leaves, lettering, rectangle, weather
from covinz_agents.world.noise import Colour, Field, Patch, blend, blotches, fractal, grain, shade

_NAMES = (
    "LIBRARY", "CAFE", "LAB 3", "PHYSICS", "BOOKS", "ATELIER", "BAKERY", "HALL B", "MENSA", "OPTIK",
    "GALLERY", "STUDIO 7", "CHEMISTRY", "PRINT", "VELO", "ARCHIVE", "BANK", "MUSIC", "PHARMACY",
    "ROBOTICS", "GARDEN", "TAILOR", "FLOWERS", "CLINIC", "THEATRE", "RADIO", "POST", "MUSEUM",
)  # fmt: skip


def _name(patch: Patch) -> str:
    return _NAMES[int(patch.rng.integers(len(_NAMES)))]


def _vivid(patch: Patch) -> Colour:
    """A colour that is neither grey nor pale."""
    return patch.pick(
        (60, 60, 190), (160, 90, 40), (70, 140, 60), (40, 130, 200), (120, 50, 110), (40, 40, 45)
    )


def _plaster_facade(patch: Patch) -> Field:
    image = patch.flat(
        patch.pick(
            (175, 205, 222), (200, 212, 218), (160, 190, 215), (188, 200, 190), (215, 205, 190)
        )
    )
    weather(patch, image, 0.10)
    blend(image, (150, 165, 175), 0.6 * blotches(patch, 1.2, 0.08))
    band = patch.pick((225, 232, 235), (120, 140, 160), (150, 160, 165))
    for storey in range(1, _storeys(patch)):
        rectangle(patch, image, (0, _down_m(patch, storey, 0.1)), (patch.width_m, 0.18), band)
    return _inhabited(patch, image)


def _brick_facade(patch: Patch) -> Field:
    image = patch.flat(patch.pick((70, 85, 150), (85, 105, 160), (100, 130, 170), (75, 80, 120)))
    courses(patch, image, 0.26, 0.085, joint=(150, 160, 165), joint_m=0.012)
    weather(patch, image, 0.12)
    return _inhabited(patch, image)


def _stone_facade(patch: Patch) -> Field:
    image = patch.flat(patch.pick((150, 165, 172), (165, 180, 190), (140, 150, 155)))
    size = float(patch.rng.uniform(0.7, 1.1)), float(patch.rng.uniform(0.32, 0.5))
    courses(patch, image, *size, joint=(95, 105, 110), joint_m=0.02, spread=0.09)
    weather(patch, image, 0.13)
    return _inhabited(patch, image)


def _storeys(patch: Patch) -> int:
    return max(1, int(patch.height_m / STOREY_M))


def _down_m(patch: Patch, storey: int, above_m: float) -> float:
    """Distance from the upper edge of a front to a height above the floor of a storey."""
    return patch.height_m - 0.6 - STOREY_M * storey - above_m


def _inhabited(patch: Patch, image: Field) -> Field:
    """Windows in rows, ivy, and what people paint and paste on the lowest metres."""
    if patch.rng.random() < 0.3:
        _ivy(patch, image)
    pitch_m, width_m = float(patch.rng.uniform(2.1, 3.3)), float(patch.rng.uniform(1.0, 1.5))
    frame = patch.pick((235, 235, 235), (60, 70, 90), (90, 60, 40), (200, 215, 225))
    number = max(1, int((patch.width_m - 0.6) / pitch_m))
    for storey in range(_storeys(patch)):
        top_m = _down_m(patch, storey, 2.5)
        for k in range(number):
            left_m = (k + 0.5) * patch.width_m / number - width_m / 2
            _window(patch, image, (left_m, top_m), (width_m, 1.6), frame)
    for _ in range(int(patch.width_m / 4)):
        _pasted(patch, image)
    shade(image, 0.03 * grain(patch))
    return image


def _window(
    patch: Patch, image: Field, low: tuple[float, float], size: tuple[float, float], frame: Colour
) -> None:
    """A window with its frame, sill, glass and whatever is behind it."""
    (x, y), (width, height) = low, size
    rectangle(patch, image, (x - 0.12, y - 0.12), (width + 0.24, height + 0.2), frame)
    rectangle(patch, image, (x - 0.2, y + height + 0.08), (width + 0.4, 0.14), (190, 195, 200))
    rectangle(patch, image, (x - 0.15, y + height + 0.22), (width + 0.3, 0.1), (70, 75, 80))
    glass = float(patch.rng.uniform(25, 90))
    rectangle(patch, image, low, size, (glass * 1.3, glass * 1.1, glass))
    kind = patch.rng.random()
    if kind < 0.3:
        share = float(patch.rng.uniform(0.15, 0.4))
        for at in (x, x + (1 - share) * width):
            rectangle(patch, image, (at, y), (share * width, height), (190, 200, 205))
    elif kind < 0.55:
        blind = float(patch.rng.uniform(0.2, 0.9)) * height
        rectangle(patch, image, low, (width, blind), patch.pick((180, 190, 195), (110, 120, 140)))
    elif kind < 0.65:
        rectangle(patch, image, (x, y + 0.6 * height), (0.4 * width, 0.4 * height), _vivid(patch))
    for k in range(1, int(patch.rng.integers(2, 4))):
        rectangle(patch, image, (x + k * width / 2 - 0.03, y), (0.06, height), frame)
    rectangle(
        patch, image, (x, y + float(patch.rng.uniform(0.3, 0.5)) * height), (width, 0.06), frame
    )
    if patch.rng.random() < 0.2:
        shutter = _vivid(patch)
        for at in (x - 0.6, x + width + 0.14):
            rectangle(patch, image, (at, y - 0.05), (0.46, height + 0.1), shutter)
    if patch.rng.random() < 0.2:
        rectangle(patch, image, (x - 0.1, y + height - 0.1), (width + 0.2, 0.24), (50, 110, 60))


def _ivy(patch: Patch, image: Field) -> None:
    green = leaves(patch, 0.16, (25, 45, 30), (80, 140, 90), cover=1.2)
    height = np.linspace(1.2, -1.2, patch.height_px, dtype=np.float32)[:, None]
    side = np.linspace(-1, 1, patch.width_px, dtype=np.float32)[None] * patch.rng.choice([-1, 1])
    grown = fractal(patch, 3.0, 0.15) + 1.2 * side - 0.8 * height > 0.9
    image[grown] = green[grown]


def _pasted(patch: Patch, image: Field) -> None:
    """A poster, a plate or something sprayed, on the lowest 2.6 m."""
    x = float(patch.rng.uniform(0.2, max(0.3, patch.width_m - 1.2)))
    y = patch.height_m - float(patch.rng.uniform(0.9, 2.4))
    if patch.rng.random() < 0.5:
        size = float(patch.rng.uniform(0.3, 0.8)), float(patch.rng.uniform(0.3, 0.9))
        rectangle(
            patch, image, (x, y), size, patch.pick((220, 225, 225), (90, 160, 210), (150, 150, 60))
        )
        rectangle(patch, image, (x + 0.08, y + 0.1), (size[0] - 0.16, 0.1), _vivid(patch))
        rectangle(patch, image, (x + 0.08, y + 0.3), (size[0] * 0.5, 0.12), _vivid(patch))
    else:
        lettering(patch, image, _name(patch)[:5].title(), (x, y), 0.35, _vivid(patch))


def _plaster(patch: Patch) -> Field:
    image = patch.flat(patch.pick((175, 190, 200), (150, 165, 175), (190, 195, 195)))
    weather(patch, image, 0.15)
    return image


def _door(patch: Patch) -> Field:
    image = patch.flat(
        patch.pick((45, 60, 95), (70, 55, 40), (50, 80, 55), (60, 60, 150), (80, 85, 90))
    )
    shade(image, 0.1 * fractal(patch, 0.3, 0.03, stretch=6.0))
    frame = (185, 195, 200)
    for at, size in (((0, 0), (patch.width_m, 0.14)), ((0, 0), (0.12, patch.height_m)),
                     ((patch.width_m - 0.12, 0), (0.12, patch.height_m))):  # fmt: skip
        rectangle(patch, image, at, size, frame)
    rectangle(patch, image, (0.3, 0.35), (patch.width_m - 0.6, 0.8), (95, 85, 70))
    rectangle(patch, image, (patch.width_m / 2 - 0.02, 0.3), (0.04, patch.height_m), (25, 25, 30))
    for y in (1.4, 2.0):
        for x in (0.3, patch.width_m / 2 + 0.1):
            rectangle(patch, image, (x, y), (patch.width_m / 2 - 0.42, 0.45), (40, 45, 50))
    number = str(int(patch.rng.integers(1, 99)))
    lettering(patch, image, number, (patch.width_m / 2 - 0.2, 0.8), 0.25, (230, 235, 235))
    return image


def _shop_front(patch: Patch) -> Field:
    """A window with goods behind it and a name above."""
    image = patch.flat(patch.pick((70, 60, 50), (60, 65, 70), (90, 80, 60)))
    shade(image, 0.25 * fractal(patch, 1.0, 0.1))
    for _ in range(int(9 * patch.width_m)):
        size = patch.rng.uniform([0.08, 0.08], [0.45, 0.5])
        at = patch.rng.uniform(0, 1, 2) * [patch.width_m - 0.3, patch.height_m - 0.7] + [0, 0.5]
        tone, tint = patch.rng.uniform(40, 200), patch.rng.normal(0, 22, 3)
        colour = np.clip(tone + tint, 10, 240)
        rectangle(patch, image, (at[0], at[1]), (size[0], size[1]), tuple(colour.tolist()))
    board = _vivid(patch)
    rectangle(patch, image, (0, 0), (patch.width_m, 0.45), board)
    lettering(patch, image, _name(patch), (0.2, 0.36), 0.26, (225, 235, 235))
    for x in np.arange(0, patch.width_m, 1.3):
        rectangle(patch, image, (float(x), 0.45), (0.07, patch.height_m), (60, 65, 70))
    return image


def _sign(patch: Patch) -> Field:
    """A board with text."""
    ground = patch.pick((225, 230, 230), (150, 90, 30), (50, 50, 170), (60, 120, 60), (30, 35, 40))
    ink = (30, 35, 40) if ground[0] > 200 else (230, 235, 235)
    image = patch.flat(ground)
    edge = 0.06
    rectangle(patch, image, (edge, edge), (patch.width_m - 2 * edge, 0.03), ink)
    line_m = min(0.45 * patch.height_m, 0.3 * patch.width_m)
    lines = max(1, int(patch.height_m / (1.5 * line_m)))
    for k in range(lines):
        text = _name(patch) if k == 0 else f"{_name(patch)[:4].lower()} {patch.rng.integers(100)}"
        high_m = min(line_m, 1.1 * (patch.width_m - 0.3) / max(4, len(text)))
        at = (0.15, (k + 0.8) * patch.height_m / lines - 0.05)
        lettering(patch, image, text, at, high_m, ink if k % 2 == 0 else _vivid(patch))
    x, y = patch.rng.uniform(0, 0.7, 2) * [patch.width_m, patch.height_m]
    rectangle(patch, image, (x, y), (0.1 * patch.width_m, 0.1 * patch.height_m), _vivid(patch))
    shade(image, 0.05 * fractal(patch, 0.5, 0.05))
    return image


def _awning(patch: Patch) -> Field:
    stripe, other = _vivid(patch), patch.pick((220, 225, 225), (180, 190, 200), (90, 110, 130))
    image = patch.flat(other)
    wide_m = float(patch.rng.uniform(0.18, 0.35))
    for x in np.arange(float(patch.rng.uniform(0, 0.3)), patch.width_m, 2 * wide_m):
        rectangle(patch, image, (float(x), 0), (wide_m, patch.height_m), stripe)
    shade(image, 0.1 * fractal(patch, 0.8, 0.05))
    return image


def _balcony(patch: Patch) -> Field:
    """Rails before a dark gap, and boxes of flowers."""
    image = patch.flat(patch.pick((70, 75, 80), (120, 130, 140), (95, 90, 85)))
    bar, pitch_m = patch.pick((210, 215, 215), (40, 40, 45), (60, 90, 70)), 0.16
    for x in np.arange(0, patch.width_m, pitch_m):
        rectangle(patch, image, (float(x), 0), (0.05, patch.height_m), bar)
    rectangle(patch, image, (0, 0), (patch.width_m, 0.08), bar)
    rectangle(patch, image, (0, patch.height_m - 0.16), (patch.width_m, 0.16), (165, 170, 175))
    flowers = leaves(patch, 0.1, (30, 60, 40), _vivid(patch), cover=1.0)
    here = fractal(patch, 0.8, 0.1) > 0.7
    image[here] = flowers[here]
    return image


def _bay(patch: Patch) -> Field:
    """A bay with a window in it."""
    image = patch.flat(patch.pick((190, 205, 215), (90, 110, 140), (120, 140, 120)))
    weather(patch, image, 0.1)
    size = max(0.2, patch.width_m - 0.4), max(0.3, 0.55 * patch.height_m)
    _window(patch, image, (0.2, 0.2 * patch.height_m), size, (230, 232, 232))
    return image


def _cornice(patch: Patch) -> Field:
    image = patch.flat((185, 195, 200))
    for y in (0.1, 0.22, 0.36):
        rectangle(patch, image, (0, y), (patch.width_m, 0.03), (110, 118, 125))
    for x in np.arange(0.2, patch.width_m, 0.6):
        rectangle(patch, image, (float(x), 0.25), (0.15, 0.1), (95, 100, 110))
    weather(patch, image, 0.15)
    return image


def _roof_tiles(patch: Patch) -> Field:
    image = patch.flat(patch.pick((60, 80, 150), (70, 75, 110), (85, 88, 95)))
    courses(patch, image, 0.3, 0.22, joint=(35, 38, 50), joint_m=0.04, spread=0.14)
    shade(image, 0.15 * fractal(patch, 2.0, 0.1))
    blend(image, (70, 110, 90), 0.5 * blotches(patch, 0.7, 0.08))
    for x in patch.rng.uniform(1.0, max(1.1, patch.width_m - 1.5), int(patch.width_m / 7)):
        size = 0.8, 0.35 * patch.height_m
        rectangle(patch, image, (float(x), 0.3 * patch.height_m), size, (60, 55, 50))
        rectangle(
            patch,
            image,
            (float(x) + 0.1, 0.35 * patch.height_m),
            (0.6, 0.7 * size[1]),
            (150, 130, 110),
        )
    return image


MATERIALS: Mapping[str, Callable[[Patch], Field]] = {
    "plaster_facade": _plaster_facade, "brick_facade": _brick_facade,
    "stone_facade": _stone_facade, "plaster": _plaster, "door": _door, "shop_front": _shop_front,
    "sign": _sign, "awning": _awning, "balcony": _balcony, "bay": _bay, "cornice": _cornice,
    "roof_tiles": _roof_tiles,
}  # fmt: skip
