"""A small rendered hall for system tests: small images, so that hundreds take seconds.

Images are kept for the whole run of the tests (see conftest.py).
"""

from __future__ import annotations

import math
from typing import Any

SCENE: dict[str, Any] = {"kind": "hall", "seed": 3, "size_m": [12.0, 9.0, 5.0]}
CAMERA: dict[str, Any] = {
    "model": "OPENCV",
    "width": 320,
    "height": 240,
    "params": [195.0, 195.5, 159.2, 120.9, -0.1, 0.02, 5e-4, -3e-4],
    "T_body_cam": [0, 0, 1, 0.1, -1, 0, 0, 0.03, 0, -1, 0, 0.05, 0, 0, 0, 1],
}


def arc(from_rad: float, to_rad: float, start_s: float = 0.0) -> dict[str, Any]:
    """A path along an ellipse around the middle of the hall; it looks at the walls."""
    angles = [from_rad + (to_rad - from_rad) * k / 6 for k in range(7)]
    return {
        "kind": "waypoints",
        "points_m": [[3 * math.cos(a), 2 * math.sin(a), 1.5] for a in angles],
        "look_rad": -1.2 if to_rad > from_rad else 1.2,
        "speed_m_s": 0.7,
        "start_s": start_s,
    }
