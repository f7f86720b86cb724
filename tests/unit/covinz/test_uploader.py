"""The pauses of the uploader; its behaviour is tested in test_agent.py."""

from __future__ import annotations

import random

from covinz.config import AgentConfig
from covinz.uploader import Backoff


def test_pauses_double_up_to_the_limit_and_scatter() -> None:
    config = AgentConfig(min_backoff_s=0.1, max_backoff_s=1.0)
    pauses: list[list[float]] = []
    for seed in range(50):
        backoff = Backoff(config, random.Random(seed))
        pauses.append([backoff.failed() for _ in range(6)])
    for step, limit in zip(zip(*pauses, strict=True), (0.1, 0.2, 0.4, 0.8, 1.0, 1.0), strict=True):
        assert 0.5 * limit <= min(step) < 0.6 * limit
        assert 0.9 * limit < max(step) <= limit


def test_a_success_ends_the_growth() -> None:
    backoff = Backoff(AgentConfig(min_backoff_s=0.1, max_backoff_s=1.0), random.Random(0))
    for _ in range(4):
        backoff.failed()
    backoff.reset()
    assert backoff.failed() <= 0.1
