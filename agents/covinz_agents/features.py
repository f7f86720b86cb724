"""ORB features on a grid: the corners of a frame, chosen so that they cover it.

OpenCV's own choice is the strongest corners of the whole image, which clump on one textured
object and leave the geometry badly conditioned (61 % of an 8 x 6 grid occupied on a rendered
hall). Detection, orientation and descriptors are OpenCV's.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz.config import FeatureConfig
from covinz.types import Features, FeatureType

# Every corner above the lower threshold is wanted: more than any image has.
_ALL_CORNERS = 60_000
# Radius of the rotated sampling pattern, so that descriptors see no reflected border.
_EDGE_PX = 19
# A cell is divided into so many parts a side, which take turns in giving their best corner.
_PARTS = 4
# Weak corners are chosen so many times more rarely: they cover the image, but match badly (at
# equal terms they cost a fifth of the pairs of redkitchen views with 30 or more inliers). Chosen
# on that scene, by its true poses; at equal terms (1) its lockstep run has 143 loops, 4 of them
# wrong, instead of 144 and 1.
_WEAK_TURNS = 4


def extract(image: NDArray[np.uint8], config: FeatureConfig) -> Features:
    """Extract at most ``config.num_features`` ORB features that cover the image.

    Pyramid levels contribute in proportion to 1 / scale; in a level the cells of the grid take
    turns in giving their best corner. A cell without a corner above ``fast_threshold`` uses
    those above ``min_fast_threshold``. The result depends on the pixels and the configuration
    alone. Features are ordered by pyramid level.

    Args:
        image: (H, W) grey or (H, W, 3) BGR, uint8.
        config: Number, grid, pyramid and thresholds.

    Returns:
        Keypoints in pixels of the image as given, (0, 0) being the centre of the top-left
        pixel, and their 32-byte descriptors; empty for an image without corners.

    Raises:
        ValueError: If `image` has another shape or type.

    Source: Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV 2011; paper IV-A
    (1,000 ORB a keyframe).
    """
    grey = _grey(image)
    orb = _orb(config)
    corners = orb.detect(grey, None)
    if corners:
        corners = [corners[i] for i in _cover(corners, grey.shape, config)]
        corners, descriptors = orb.compute(grey, corners)
    if not corners:
        return Features(FeatureType.ORB, np.empty((0, 2), "f4"), np.empty((0, 32), "u1"))
    return Features(
        FeatureType.ORB,
        _keypoints_px(corners, grey.shape, config.scale_factor),
        np.asarray(descriptors, dtype=np.uint8),
    )


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if image.dtype != np.uint8:
        raise ValueError(f"expected an image of uint8, got {image.dtype}")
    if image.ndim == 2:
        return image
    if image.ndim == 3 and image.shape[2] == 3:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    raise ValueError(f"expected an image of shape (H, W) or (H, W, 3), got {image.shape}")


@functools.lru_cache(maxsize=8)
def _orb(config: FeatureConfig) -> cv2.ORB:
    return cv2.ORB.create(
        nfeatures=max(_ALL_CORNERS, config.num_features),
        scaleFactor=config.scale_factor,
        nlevels=config.num_levels,
        edgeThreshold=_EDGE_PX,
        scoreType=cv2.ORB_FAST_SCORE,
        fastThreshold=min(config.min_fast_threshold, config.fast_threshold),
    )


def _cover(
    corners: Sequence[cv2.KeyPoint], shape: tuple[int, ...], config: FeatureConfig
) -> NDArray[np.intp]:
    """Indices of the corners to keep, best first.

    Pyramid levels give corners in proportion to their shares; in a level the cells of the grid
    take turns, and in a cell its parts, each with its strongest corner.
    """
    x, y = np.asarray(cv2.KeyPoint.convert(corners)).T
    score = np.array([corner.response for corner in corners])
    level = np.array([corner.octave for corner in corners])
    columns, rows = config.grid
    part_x = (x * (columns * _PARTS) / shape[1]).astype(int)
    part_y = (y * (rows * _PARTS) / shape[0]).astype(int)
    cell = part_y // _PARTS * columns + part_x // _PARTS
    part = part_y * (columns * _PARTS) + part_x

    # FAST's score is the highest threshold at which the corner would still be found.
    strong = score >= config.fast_threshold
    has_strong = np.bincount(cell[strong], minlength=columns * rows) > 0
    order = np.flatnonzero(strong | ~has_strong[cell])

    # x and y only make the order of equal scores a function of the image.
    order = order[np.lexsort((x[order], y[order], -score[order], part[order], level[order]))]
    turn = _rank_in_group(part[order], level[order])
    order = order[np.lexsort((-score[order], turn, cell[order], level[order]))]
    turn = _rank_in_group(cell[order], level[order])
    turn = np.where(strong[order], turn, _WEAK_TURNS * (turn + 1))
    order = order[np.lexsort((-score[order], turn, level[order]))]
    share = np.power(config.scale_factor, -level[order].astype(float))
    turn_of_level = (_rank_in_group(level[order]) + 0.5) / share
    return order[np.argsort(turn_of_level, kind="stable")][: config.num_features]


def _rank_in_group(*sorted_keys: NDArray[np.intp]) -> NDArray[np.intp]:
    """0, 1, 2, ... within every run of equal keys."""
    index = np.arange(len(sorted_keys[0]))
    is_first = np.ones(len(index), dtype=bool)
    is_first[1:] = np.any([key[1:] != key[:-1] for key in sorted_keys], axis=0)
    return index - np.maximum.accumulate(np.where(is_first, index, 0))


def _keypoints_px(
    corners: Sequence[cv2.KeyPoint], shape: tuple[int, ...], scale_factor: float
) -> NDArray[np.float32]:
    """Positions in the image itself.

    OpenCV multiplies the position in a pyramid level by its scale, which maps corners of pixels
    rather than centres and shifts level 7 by 1.3 px; levels also have whole numbers of pixels.
    """
    scale = np.power(np.float32(scale_factor), [corner.octave for corner in corners])[:, None]
    size = np.array([shape[1], shape[0]], dtype=float)
    level_px = np.rint(cv2.KeyPoint.convert(corners) / scale)
    return ((level_px + 0.5) * (size / np.rint(size / scale)) - 0.5).astype(np.float32)
