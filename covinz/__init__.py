"""covinz: what two or more of its processes share, installable on a robot (pure Python).

A robot needs what is exported here: an ``Agent`` and the values that it sends.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from covinz.types import Camera, Correction, Features, FeatureType, KeyframeContent, KeyframeId

if TYPE_CHECKING:
    from covinz.agent import Agent
    from covinz.bus import MessageTooLarge
    from covinz.spool import SpoolError
    from covinz.spool_writer import StampError

__all__ = [
    "Agent",
    "Camera",
    "Correction",
    "FeatureType",
    "Features",
    "KeyframeContent",
    "KeyframeId",
    "MessageTooLarge",
    "SpoolError",
    "StampError",
]
# Only who asks for these pays for what is behind them, the bus above all.
_LAZY = {
    "Agent": "covinz.agent",
    "MessageTooLarge": "covinz.bus",
    "SpoolError": "covinz.spool",
    "StampError": "covinz.spool_writer",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
