"""When the next optimisation may begin, so that loops that keep coming share one."""

from __future__ import annotations

import math

from covinz.config import OptimizerConfig


class Pace:
    """Rests after each optimisation in proportion to what it took.

    Every map is made from scratch (decision 0003), so one optimisation after ten loops costs about
    as much as one after each of them did. The first after a rest begins at once.

    Source: decision 0032.
    """

    def __init__(self, config: OptimizerConfig) -> None:
        self._rest_per_work = 1.0 / config.max_share - 1.0
        self._max_rest_s = config.max_rest_s
        self._began_s = -math.inf
        self.rests_until_s = -math.inf

    def begin(self, now_s: float) -> None:
        """An optimisation begins."""
        self._began_s = now_s

    def end(self, now_s: float) -> None:
        """It has ended."""
        rest_s = self._rest_per_work * (now_s - self._began_s)
        self.rests_until_s = now_s + min(rest_s, self._max_rest_s)
