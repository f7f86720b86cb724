"""Painted patterns of bricks, slabs, tiles and planks."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz_agents.world.noise import Colour, Field, Patch, blend, fractal, grain, shade


def courses(
    patch: Patch,
    image: Field,
    length_m: float,
    height_m: float,
    *,
    joint: Colour,
    joint_m: float = 0.015,
    spread: float = 0.15,
    shift: float = 0.5,
) -> None:
    """Lay bricks over an image (H, W, 3): each with a shade of its own, joints between them.

    Args:
        patch: Where.
        image: Changed in place.
        length_m: Of a brick along x.
        height_m: Of a course.
        joint: Colour of the joints.
        joint_m: Width of the joints.
        spread: Standard deviation of the bricks' shades.
        shift: How far every second course is shifted, as a share of a brick.
    """
    x = (np.arange(patch.width_px) + 0.5) / patch.x_px_per_m
    y = (np.arange(patch.height_px) + 0.5) / patch.y_px_per_m
    course = (y / height_m).astype(np.intp)
    along = x[None] / length_m + (shift * (course % 2))[:, None] + 1e-6
    brick = along.astype(np.intp)
    shades = patch.rng.normal(0, spread, (course.max() + 1, brick.max() + 1)).astype(np.float32)
    shade(image, shades[course[:, None], brick])
    # Never thinner than two thirds of a pixel, and then as faint as it would look.
    seen_m = max(joint_m, 0.7 / patch.px_per_m)
    strength = np.float32(joint_m / seen_m)
    upright = np.abs(along - brick - 0.5) * length_m > (length_m - seen_m) / 2
    level = np.abs(y / height_m - course - 0.5) * height_m > (height_m - seen_m) / 2
    blend(image, joint, strength * (upright | level[:, None]).astype(np.float32))


def weather(patch: Patch, image: Field, dirt: float = 0.12) -> None:
    """Stains that run down, and dirt that gathers at the foot."""
    shade(image, np.float32(dirt) * fractal(patch, 3.0, 0.06))
    shade(image, np.float32(0.6 * dirt) * fractal(patch, 0.35, 0.05, stretch=8.0))
    height = (np.arange(patch.height_px)[::-1] + 0.5) / patch.y_px_per_m
    foot = np.exp(-height / 0.5).astype(np.float32)[:, None]
    shade(image, -0.25 * foot * (1 + 0.3 * fractal(patch, 0.8, 0.05)))
    shade(image, 0.03 * grain(patch))


def rectangle(
    patch: Patch, image: Field, low_m: tuple[float, float], size_m: tuple[float, float], bgr: Colour
) -> None:
    """Fill a rectangle; its upper left corner and size along x and y (down) in metres."""
    x0, x1 = (round(patch.x_px_per_m * v) for v in (low_m[0], low_m[0] + size_m[0]))
    y0, y1 = (round(patch.y_px_per_m * v) for v in (low_m[1], low_m[1] + size_m[1]))
    image[max(y0, 0) : max(y1, y0 + 1), max(x0, 0) : max(x1, x0 + 1)] = bgr


def lettering(
    patch: Patch, image: Field, text: str, at_m: tuple[float, float], high_m: float, bgr: Colour
) -> None:
    """Write text; its lower left corner and the height of its capitals in metres."""
    font = int(patch.rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX,
                                 cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_TRIPLEX]))  # fmt: skip
    scale = high_m * patch.y_px_per_m / 21.0
    place = round(at_m[0] * patch.x_px_per_m), round(at_m[1] * patch.y_px_per_m)
    cv2.putText(image, text, place, font, scale, bgr, max(1, round(2.2 * scale)), cv2.LINE_AA)


def leaves(patch: Patch, size_m: float, dark: Colour, light: Colour, cover: float = 2.0) -> Field:
    """(H, W, 3) foliage: leaves over leaves, the later ones lighter."""
    image = patch.flat(dark)
    shade(image, 0.3 * fractal(patch, 0.5, 0.04))
    number = int(cover * patch.width_m * patch.height_m / size_m**2)
    x, y = (
        patch.rng.uniform(0, patch.width_px, number),
        patch.rng.uniform(0, patch.height_px, number),
    )
    radius = np.maximum(patch.rng.uniform(0.3, 0.7, number) * size_m * patch.px_per_m, 0.8)
    angle, narrow = patch.rng.uniform(0, 180, number), patch.rng.uniform(0.35, 0.8, number)
    share = np.linspace(0, 1, number) * patch.rng.uniform(0.4, 1.1, number)
    colours = np.array(dark) + share[:, None] * (np.array(light) - np.array(dark))
    for k in range(number):
        axes = int(16 * radius[k]), int(16 * radius[k] * narrow[k])
        at = int(16 * x[k]), int(16 * y[k])
        _leaf(image, at, axes, float(angle[k]), colours[k])
    return image


def _leaf(
    image: Field, at: tuple[int, int], axes: tuple[int, int], angle: float, bgr: NDArray[np.float64]
) -> None:
    """A filled ellipse; place and axes in sixteenths of a pixel."""
    corners = cv2.ellipse2Poly((0, 0), axes, round(angle), 0, 360, 60)
    cv2.fillConvexPoly(image, corners + np.array(at), bgr.tolist(), cv2.LINE_AA, 4)
