"""The doors of the optimizer: what bus threads put into the inbox, and answers to questions."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass

from covinz import codec, keyexprs
from covinz.bus import Bus, MessageTooLarge, Query
from covinz.service import Inbox
from covinz.types import Correction, RetryAfter, UploadReply
from services.optimizer.maps import Maps

logger = logging.getLogger(__name__)

# What a worker is told to wait when a loop cannot be taken now. [s]
RETRY_AFTER_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LoopBrought:
    """A worker waits until its loop is durable."""

    query: Query


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """Somebody asks for a map, the list of maps or a correction."""

    query: Query


def open_doors(bus: Bus, inbox: Inbox) -> ExitStack:
    """Take loops and questions; who finds the inbox full is turned away."""

    def take_loop(query: Query) -> None:
        if not inbox.put(LoopBrought(query), block=False):
            reply(query, RetryAfter(RETRY_AFTER_S, "too many loops wait"))

    def take_question(query: Query) -> None:
        if not inbox.put(Asked(query), block=False):
            query.drop()

    stack = ExitStack()
    stack.enter_context(closing(bus.answer(keyexprs.LOOP, take_loop)))
    for key in (keyexprs.MAP_LIST, keyexprs.MAP_SNAPSHOTS, keyexprs.AGENT_CORRECTIONS):
        stack.enter_context(closing(bus.answer(key, take_question)))
    return stack


def reply(query: Query, answer: UploadReply) -> None:
    """Answer a worker."""
    query.reply(codec.encode(answer))


def answer_question(query: Query, maps: Maps, corrections: Mapping[str, Correction]) -> None:
    """Answer a question, or end it when there is no such map or correction."""
    found = _find(query.key, maps, corrections)
    if found is None:
        query.drop()
        return
    try:
        query.reply(codec.encode(found))
    except MessageTooLarge as error:  # the query has been ended
        logger.error("no answer to %s: %s", query.key, error)


def _find(key: str, maps: Maps, corrections: Mapping[str, Correction]) -> object | None:
    if key == keyexprs.MAP_LIST:
        return maps.map_list()
    try:
        if key.startswith("covinz/map/"):
            return maps.snapshot(keyexprs.map_of(key))
        return corrections.get(keyexprs.agent_of(key))
    except ValueError:
        return None
