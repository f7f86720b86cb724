"""SIFT features on a grid, as RootSIFT in one byte a component; the rest is OpenCV's."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz.config import FeatureConfig, SiftConfig
from covinz.types import Features, FeatureType
from covinz_agents.coverage import Corners, cover

# Levels in an octave of the pyramid, edge and blur: Lowe's. OpenCV divides the threshold of
# contrast by the levels.
_LAYERS = 3
_EDGE = 10.0
_SIGMA = 1.6
# A descriptor is a unit vector of components in [0, 1], few of them above a half. [OpenCV's own
# factor for SIFT in bytes]
_BYTE_SCALE = 512.0


def extract_sift(grey: NDArray[np.uint8], config: FeatureConfig) -> Features:
    """At most ``config.sift.num_features`` SIFT features that cover a grey image (H, W).

    A cell of the grid without a point above ``contrast_threshold`` uses those above
    ``min_contrast_threshold``. A point with two orientations gives two features. Features are
    ordered by octave.

    Source: Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004;
    COVINS-G IV-E.
    """
    detector = _sift(config.sift)
    points = detector.detect(grey, None)
    if points:
        points = [points[i] for i in _cover(points, grey.shape, config)]
        points.sort(key=_octave)
        points, descriptors = detector.compute(grey, points)
    if not points:
        return Features(FeatureType.SIFT, np.empty((0, 2), "f4"), np.empty((0, 128), "u1"))
    px = np.asarray(cv2.KeyPoint.convert(points), np.float32)
    return Features(FeatureType.SIFT, px, root_sift(np.asarray(descriptors, np.float32)))


def root_sift(descriptors: NDArray[np.float32]) -> NDArray[np.uint8]:
    """SIFT descriptors (N, 128) of any length as bytes: 512 times the root of their shares.

    Euclidean distances of the roots are Hellinger distances of the histograms, which compare
    small bins as well as large ones. All have length 512, so a byte loses little: rounding moves
    a distance by about 3 of the 300 to 400 that unrelated descriptors are apart.

    Source: Arandjelovic and Zisserman, "Three things everyone should know to improve object
    retrieval", CVPR 2012.
    """
    sums = np.maximum(descriptors.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)
    scaled = np.rint(_BYTE_SCALE * np.sqrt(descriptors / sums))
    return np.asarray(np.minimum(scaled, 255), dtype=np.uint8)


@functools.lru_cache(maxsize=8)
def _sift(config: SiftConfig) -> cv2.SIFT:
    return cv2.SIFT.create(
        nfeatures=0,
        nOctaveLayers=_LAYERS,
        contrastThreshold=min(config.min_contrast_threshold, config.contrast_threshold),
        edgeThreshold=_EDGE,
        sigma=_SIGMA,
        # Without it positions are a quarter of a pixel off.
        enable_precise_upscale=True,
    )


def _cover(
    points: Sequence[cv2.KeyPoint], shape: tuple[int, ...], config: FeatureConfig
) -> NDArray[np.intp]:
    score = np.array([point.response for point in points])
    octave = np.array([_octave(point) for point in points])
    found = Corners(
        px=np.asarray(cv2.KeyPoint.convert(points), np.float32),
        score=score,
        level=octave,
        scale=np.power(2.0, octave.astype(float)),
        strong=score * _LAYERS >= config.sift.contrast_threshold,
    )
    return cover(found, shape, config.grid, config.sift.num_features)


def _octave(point: cv2.KeyPoint) -> int:
    """-1 for the image enlarged twice, 0 for the image itself, and so on."""
    packed = int(point.octave) & 0xFF
    return packed - 256 if packed >= 128 else packed
