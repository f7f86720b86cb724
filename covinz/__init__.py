"""covinz: what two or more of its processes share, installable on a robot (pure Python).

A robot needs what is exported here: an ``Agent`` and the values that it sends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from covinz.types import Camera, Correction, Features, FeatureType, KeyframeContent, KeyframeId

if TYPE_CHECKING:
    from covinz.agent import Agent

__all__ = [
    "Agent",
    "Camera",
    "Correction",
    "FeatureType",
    "Features",
    "KeyframeContent",
    "KeyframeId",
]


def __getattr__(name: str) -> Any:
    # Only who asks for the agent pays for the bus behind it.
    if name == "Agent":
        from covinz.agent import Agent

        return Agent
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
