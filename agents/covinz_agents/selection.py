"""Which frames become keyframes: by motion of the odometry since the last one."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from covinz import frames
from covinz.config import KeyframeSelectionConfig
from covinz.types import Array
from covinz_agents.source import Frame


class KeyframeSelector:
    """Decides frame by frame, remembering the last keyframe.

    Source: COVINS-G's public front-end: a keyframe is due at 0.15 m or 0.15 rad.
    """

    def __init__(self, config: KeyframeSelectionConfig) -> None:
        self._config = config
        self._T_odom_last: Array | None = None

    def is_due(self, T_odom_body: Array) -> bool:
        """Whether this frame becomes a keyframe; the first one always does.

        Args:
            T_odom_body: (4, 4) odometry of the frame.
        """
        if self._T_odom_last is not None:
            T_last_body = frames.inverse(self._T_odom_last) @ T_odom_body
            moved_m = float(np.linalg.norm(T_last_body[:3, 3]))
            turned_rad = float(frames.rotation_angle(T_last_body))
            if moved_m < self._config.translation_m and turned_rad < self._config.rotation_rad:
                return False
        self._T_odom_last = T_odom_body
        return True


def select_keyframes(candidates: Iterable[Frame], config: KeyframeSelectionConfig) -> list[Frame]:
    """The frames that become keyframes, in the same order."""
    selector = KeyframeSelector(config)
    return [frame for frame in candidates if selector.is_due(frame.T_odom_body)]
