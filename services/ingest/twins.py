"""Two robots under one id: noticed by their sessions, which grow in turns.

A robot has one session at a time. After a restart or a reset of its odometry what is left of the
old session comes first, so both are mixed for a few uploads at most; two robots go on for ever.
Their keyframes are never mixed up, for a session is one robot's. But corrections go to the newest
session, and each robot would be a segment of the other's. So the one that came later waits, with
its keyframes in its spool, until it has an id of its own or the other one is gone.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from covinz.types import Gap, Keyframe, RetryAfter

logger = logging.getLogger(__name__)

# So many times the older of two sessions goes on after the newer one: more than uploads under way
# can change places in. [twice `agent.window`]
TURNS = 8
# A session without news for so long is over, and its robot gone. [s]
GONE_S = 60.0
# How soon the one that waits asks again. [s]
RETRY_S = 5.0
# Sessions of one agent that are remembered.
MAX_SESSIONS = 8


@dataclass(slots=True)
class _Agent:
    """Times of the last news of the sessions of an agent, in the order in which they began."""

    seen_s: dict[str, float] = field(default_factory=dict)
    last: str = ""
    turns: int = 0
    is_said: bool = False


class Twins:
    """Which agents are two robots; for one thread.

    Args:
        clock_s: Monotonic time.
    """

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._agents: dict[str, _Agent] = {}

    @property
    def counters(self) -> Counter[str]:
        """``twins.<agent>``: 1 while two robots send under this id."""
        return Counter({f"twins.{name}": 1 for name, one in self._agents.items() if one.is_said})

    def judge(self, agent: str, item: Keyframe | Gap) -> RetryAfter | None:
        """Why an upload has to wait, if it is of the later one of two robots."""
        session = item.session if isinstance(item, Gap) else item.id.session
        one, now_s = self._agents.setdefault(agent, _Agent()), self._clock_s()
        self._forget_gone(agent, one, now_s)
        first = next(iter(one.seen_s), session)
        if one.is_said and session != first:
            return RetryAfter(RETRY_S, _reason(agent, first))
        one.seen_s[session] = now_s
        if session != one.last and list(one.seen_s)[-1] != session:
            one.turns += 1
        one.last = session
        if one.turns >= TURNS and not one.is_said:
            one.is_said = True
            logger.error(
                "two robots send as %s: sessions %s. Only the first one's keyframes are taken; "
                "give each robot an id of its own",
                agent,
                " and ".join(one.seen_s),
            )
        return None

    def _forget_gone(self, agent: str, one: _Agent, now_s: float) -> None:
        over = [name for name, seen_s in one.seen_s.items() if now_s - seen_s > GONE_S]
        crowd = list(one.seen_s)[:-MAX_SESSIONS]
        for name in {*over, *crowd}:
            del one.seen_s[name]
        if not one.is_said and over:
            one.turns = 0
        elif one.is_said and over:
            logger.warning("one of the robots that sent as %s is gone", agent)
            one.turns, one.is_said = 0, False


def _reason(agent: str, session: str) -> str:
    return f"another robot sends as {agent}, session {session}: give each an id of its own"
