"""Every camera model that a message can name is one that the numeric core can see through."""

from __future__ import annotations

import covinz_core
import numpy as np
import pytest

from covinz.types import NUM_CAMERA_PARAMS


@pytest.mark.parametrize("model", sorted(NUM_CAMERA_PARAMS))
def test_the_core_knows_every_model(model: str) -> None:
    params = [400.0, 410.0, 320.0, 240.0] + [0.0] * (NUM_CAMERA_PARAMS[model] - 4)
    corners_px = np.array([[320.0, 240.0], [0.0, 0.0], [639.0, 479.0]])
    bearings = covinz_core.bearing_vectors(model, params, corners_px)
    np.testing.assert_allclose(bearings[0], [0.0, 0.0, 1.0], atol=1e-12)
    back_px = covinz_core.project_points(model, params, 3.0 * bearings)
    np.testing.assert_allclose(back_px, corners_px, atol=1e-7)
