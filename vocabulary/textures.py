"""Generated textures that widen the vocabulary's training set beyond the recorded room.

Each texture is drawn from a seed alone: a fractal ground, a layer of man-made structure
(bricks, boards, print, shapes or leaves), a perspective view of it, uneven light, blur and
sensor noise.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

_WIDTH_PX = 640
_HEIGHT_PX = 480
# Drawn larger, so that the perspective view shows no border.
_CANVAS_PX = 1024

Image = NDArray[np.float32]


def draw_texture(seed: int) -> NDArray[np.uint8]:
    """Draw one grey image.

    Args:
        seed: The same seed gives the same image.

    Returns:
        (480, 640) uint8.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    layers: list[Callable[[Image, np.random.Generator], None]] = [
        _bricks,
        _boards,
        _print,
        _shapes,
        _leaves,
    ]
    canvas = _fractal(rng)
    layers[seed % len(layers)](canvas, rng)
    image = _photograph(canvas, rng)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _fractal(rng: np.random.Generator) -> Image:
    """Noise whose octaves fall off by a random roughness, around mid grey."""
    canvas = np.full((_CANVAS_PX, _CANVAS_PX), rng.uniform(90, 160), np.float32)
    roughness = rng.uniform(0.4, 0.8)
    for octave in range(2, 10):
        noise = rng.standard_normal((2**octave, 2**octave), dtype=np.float32)
        size = (_CANVAS_PX, _CANVAS_PX)
        wave = cv2.resize(noise, size, interpolation=cv2.INTER_CUBIC)
        canvas += (40.0 * roughness ** (octave - 1)) * wave.astype(np.float32)
    return canvas


def _bricks(canvas: Image, rng: np.random.Generator) -> None:
    """Offset courses, each brick in its own shade, with lighter or darker joints."""
    height, width = int(rng.integers(24, 90)), int(rng.integers(60, 220))
    joint = float(rng.uniform(-70, 70))
    for row, y in enumerate(range(0, _CANVAS_PX, height)):
        offset = (row % 2) * width // 2
        for x in range(-offset, _CANVAS_PX, width):
            canvas[y : y + height, max(x, 0) : max(x + width, 0)] += rng.normal(0, 25)
            cv2.line(canvas, (x, y), (x, y + height), float(rng.uniform(40, 110)) + joint, 3)
        cv2.line(canvas, (0, y), (_CANVAS_PX, y), float(rng.uniform(40, 110)) + joint, 3)


def _boards(canvas: Image, rng: np.random.Generator) -> None:
    """Planks with grain, knots and screws."""
    x = 0
    while x < _CANVAS_PX:
        width = int(rng.integers(50, 160))
        grain = rng.standard_normal((1, width)).astype(np.float32) * rng.uniform(4, 20)
        plank = canvas[:, x : x + width]
        plank += grain[:, : plank.shape[1]] + rng.normal(0, 30)
        cv2.line(canvas, (x, 0), (x, _CANVAS_PX), 30.0, 2)
        for y in rng.integers(0, _CANVAS_PX, 12):
            centre = (x + int(rng.integers(5, width)), int(y))
            axes = (int(rng.integers(2, 9)), int(rng.integers(2, 16)))
            cv2.ellipse(canvas, centre, axes, 0, 0, 360, float(rng.uniform(10, 220)), -1)
        x += width


def _print(canvas: Image, rng: np.random.Generator) -> None:
    """Sheets of paper with lines of letters and digits, boxes and bars."""
    glyphs = np.array(list("ABCDEFGHKLMNPQRSTUVWXYZabcdefghkmnpqrstuvwxyz0123456789%&?"))
    for _ in range(int(rng.integers(4, 12))):
        x, y = (int(v) for v in rng.integers(-50, _CANVAS_PX - 100, 2))
        width, height = (int(v) for v in rng.integers(120, 500, 2))
        paper, ink = float(rng.uniform(150, 250)), float(rng.uniform(0, 100))
        cv2.rectangle(canvas, (x, y), (x + width, y + height), paper, -1)
        scale = float(rng.uniform(0.4, 2.5))
        font = int(rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_TRIPLEX]))
        for line in range(y + int(30 * scale), y + height, max(int(34 * scale), 12)):
            text = "".join(rng.choice(glyphs, int(rng.integers(2, 30))))
            origin = (x + 8, line)
            cv2.putText(canvas, text, origin, font, scale, ink, max(1, int(2 * scale)))


def _shapes(canvas: Image, rng: np.random.Generator) -> None:
    """Overlapping polygons, discs and bars: furniture, tiles and appliances from afar."""
    for _ in range(int(rng.integers(60, 240))):
        centre = rng.integers(0, _CANVAS_PX, 2)
        size = float(rng.lognormal(3.3, 0.7))
        shade = float(rng.uniform(0, 255))
        corners = int(rng.integers(3, 7))
        angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        polygon = np.rint(centre + size * rng.uniform(0.5, 1.5) * ring).astype(np.int32)
        if rng.random() < 0.2:
            cv2.circle(canvas, (int(centre[0]), int(centre[1])), int(size), shade, -1)
        else:
            cv2.fillPoly(canvas, [polygon], shade)


def _leaves(canvas: Image, rng: np.random.Generator) -> None:
    """Many small ellipses over one another: foliage, gravel, carpet."""
    length = rng.uniform(4, 22)
    for _ in range(int(rng.integers(1500, 4000))):
        x, y = (int(v) for v in rng.integers(0, _CANVAS_PX, 2))
        axes = (int(length * rng.uniform(0.5, 1.5)) + 1, int(length * rng.uniform(0.2, 0.6)) + 1)
        shade = float(rng.uniform(20, 235))
        cv2.ellipse(canvas, (x, y), axes, float(rng.uniform(0, 180)), 0, 360, shade, -1)


def _photograph(canvas: Image, rng: np.random.Generator) -> Image:
    """Perspective view of the canvas under uneven light, blurred and noisy."""
    frame = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    shown = frame * (_CANVAS_PX * rng.uniform(0.45, 0.7))
    shown += (_CANVAS_PX - shown.max()) / 2
    shown += rng.uniform(-0.15, 0.15, (4, 2)).astype(np.float32) * _CANVAS_PX
    size = np.array([_WIDTH_PX, _HEIGHT_PX], np.float32)
    homography = cv2.getPerspectiveTransform(shown.astype(np.float32), frame * size)
    image = cv2.warpPerspective(
        canvas, homography, (_WIDTH_PX, _HEIGHT_PX), borderMode=cv2.BORDER_REFLECT
    ).astype(np.float32)
    image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.5, 1.6))).astype(np.float32)
    light = rng.uniform(0.6, 1.2, (2, 2)).astype(np.float32)
    image *= cv2.resize(light, (_WIDTH_PX, _HEIGHT_PX), interpolation=cv2.INTER_LINEAR)
    noise = rng.standard_normal(image.shape, dtype=np.float32)
    return np.asarray(image + rng.uniform(1, 5) * noise, dtype=np.float32)
