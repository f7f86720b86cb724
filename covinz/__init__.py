"""covinz: what two or more of its processes share, installable on a robot (pure Python).

A robot needs one name of it: ``covinz.Agent``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from covinz.agent import Agent

__all__ = ["Agent"]


def __getattr__(name: str) -> Any:
    # Only who asks for the agent pays for the bus behind it.
    if name == "Agent":
        from covinz.agent import Agent

        return Agent
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
