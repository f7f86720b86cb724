"""ORB features on a grid; detection, orientation and descriptors are OpenCV's."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz.config import FeatureConfig
from covinz.types import Features, FeatureType
from covinz_agents.coverage import Corners, cover

# Every corner above the lower threshold is wanted: more than any image has.
_ALL_CORNERS = 60_000
# Radius of the rotated sampling pattern, so that descriptors see no reflected border.
_EDGE_PX = 19


def extract_orb(grey: NDArray[np.uint8], config: FeatureConfig) -> Features:
    """At most ``config.num_features`` ORB features that cover a grey image (H, W).

    A cell of the grid without a corner above ``fast_threshold`` uses those above
    ``min_fast_threshold``. Features are ordered by pyramid level.

    Source: Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV 2011; paper IV-A
    (1,000 ORB a keyframe).
    """
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
    # FAST's score is the highest threshold at which the corner would still be found.
    score = np.array([corner.response for corner in corners])
    level = np.array([corner.octave for corner in corners])
    found = Corners(
        px=np.asarray(cv2.KeyPoint.convert(corners), np.float32),
        score=score,
        level=level,
        scale=np.power(config.scale_factor, level.astype(float)),
        strong=score >= config.fast_threshold,
    )
    return cover(found, shape, config.grid, config.num_features)


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
