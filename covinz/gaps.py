"""Keyframes that never came to the server, in words, for `covinz why`."""

from __future__ import annotations

from covinz.types import Gap


def concerns(gap: Gap, keyframe: str) -> bool:
    """Whether AGENT, AGENT/SEQ or AGENT/SESSION/SEQ names a keyframe in the gap."""
    agent, *rest = keyframe.split("/")
    if agent != gap.agent or len(rest) > 2:
        return False
    if len(rest) == 2 and rest[0] != gap.session:
        return False
    return not rest or (rest[-1].isdecimal() and gap.first_seq <= int(rest[-1]) <= gap.last_seq)


def in_words(gap: Gap) -> str:
    """One line for a person."""
    which = f"keyframe {gap.first_seq}"
    if gap.last_seq > gap.first_seq:
        which = f"keyframes {gap.first_seq} to {gap.last_seq}"
    return f"{gap.agent}: {which} of session {gap.session} never came: {gap.reason}"
