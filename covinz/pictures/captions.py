"""The words over the pictures, from the figures of the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def title(made: Mapping[str, Any]) -> str:
    """Who and how many maps, e.g. ``hall: 3 robots, one map``."""
    robots, maps = len(made["agents"]), len(made["maps"])
    counted = "one robot" if robots == 1 else f"{robots} robots"
    return f"{made['scenario']}: {counted}, {'one map' if maps == 1 else f'{maps} maps'}"


def loops(made: Mapping[str, Any]) -> str:
    """How many loops, of what kind."""
    found = made["loops"]
    text = f"{found['accepted']} loop{'' if found['accepted'] == 1 else 's'}"
    if len(made["agents"]) > 1:
        text += f", {found['inter']} between robots"
    if found["wrong"] is None or not found["accepted"]:
        return text
    if not found["wrong"]:
        return f"{text}, none wrong"
    return f"{text}, {found['wrong']} wrong ({bending(found)})"


def bending(found: Mapping[str, Any]) -> str:
    """Whether wrong loops bend the map, in words; `found` are the report's figures of loops."""
    count = found["wrong_bending"]
    return f"{count or 'none'} {'bend' if count and count > 1 else 'bends'} the map"


def joint_ate(made: Mapping[str, Any]) -> str | None:
    """Joint ATE before and after; None without ground truth."""
    before_m, after_m = made["joint_ate_before_m"], made["joint_ate_after_m"]
    if before_m is None or after_m is None:
        return None
    return f"joint ATE {error(before_m)} \N{RIGHTWARDS ARROW} {error(after_m)}"


def figures(made: Mapping[str, Any]) -> str:
    """The line of figures below a title."""
    keyframes = sum(agent["keyframes"] for agent in made["agents"].values())
    path_m = sum(agent["path_m"] for agent in made["agents"].values())
    parts = [f"{keyframes} keyframes on {path_m:.0f} m", loops(made), joint_ate(made)]
    return "  \N{MIDDLE DOT}  ".join(part for part in parts if part)


def error(value_m: float) -> str:
    """A position error for people: 3.1 cm, 4.23 m, 12.3 m."""
    if value_m < 1:
        return f"{100 * value_m:.1f} cm"
    return f"{value_m:.2f} m" if value_m < 10 else f"{value_m:.1f} m"
