"""The local features of an image, of one kind or of several, chosen so that they cover it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz.config import FeatureConfig, FeatureKind
from covinz.types import Features
from covinz_agents.orb import extract_orb
from covinz_agents.sift import extract_sift

_EXTRACTORS: Final[dict[FeatureKind, Callable[[NDArray[np.uint8], FeatureConfig], Features]]] = {
    "orb": extract_orb,
    "sift": extract_sift,
}


def extract(image: NDArray[np.uint8], config: FeatureConfig) -> Features:
    """Extract the features of the first kind of ``config.kinds``; see `extract_kinds`."""
    return _EXTRACTORS[config.kinds[0]](_grey(image), config)


def extract_kinds(image: NDArray[np.uint8], config: FeatureConfig) -> tuple[Features, ...]:
    """Extract the features of every kind of ``config.kinds``, in that order.

    The result depends on the pixels and the configuration alone.

    Args:
        image: (H, W) grey or (H, W, 3) BGR, uint8.
        config: Kinds, numbers, grid, pyramid and thresholds.

    Returns:
        For each kind keypoints in pixels of the image as given, (0, 0) being the centre of the
        top-left pixel, and their descriptors; empty for an image without corners.

    Raises:
        ValueError: If `image` has another shape or type.
    """
    grey = _grey(image)
    return tuple(_EXTRACTORS[kind](grey, config) for kind in config.kinds)


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if image.dtype != np.uint8:
        raise ValueError(f"expected an image of uint8, got {image.dtype}")
    if image.ndim == 2:
        return image
    if image.ndim == 3 and image.shape[2] == 3:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    raise ValueError(f"expected an image of shape (H, W) or (H, W, 3), got {image.shape}")
