"""Corrections as a robot sees them: only its own session's, never an older one, one at a time."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from covinz import codec, keyexprs
from covinz.bus import Bus, BusClosed
from covinz.machine import THIS_MACHINE, Machine
from covinz.types import Correction

logger = logging.getLogger(__name__)


def supersedes(new: Correction, old: Correction | None) -> bool:
    """Whether `new` is news after `old`.

    Of one map the revision decides; a server that rebuilt its maps counts revisions anew, and
    after a merge the map is another one, so a later time stamp is news as well.
    """
    if old is None or new.stamp_ns > old.stamp_ns:
        return True
    return new.map_id == old.map_id and new.map_revision > old.map_revision


class CorrectionFeed:
    """The latest correction of an agent's current session.

    Args:
        bus: Way to the server.
        agent: Whose corrections.
        session: Its current session.
        on_correction: Called with the latest correction whenever there is a new one, from one
            thread; what comes while it runs replaces what waits.
        machine: For the thread.
    """

    def __init__(
        self,
        bus: Bus,
        agent: str,
        session: str,
        on_correction: Callable[[Correction], None] | None,
        machine: Machine = THIS_MACHINE,
    ) -> None:
        self._bus = bus
        self._agent = agent
        self._on_correction = on_correction
        self._changed = machine.condition()  # guards what follows
        self._session = session
        self._latest: Correction | None = None
        self._is_news = False
        self._calling = False
        self._asking = True  # what was published before this agent came
        self._stopping = False
        self._subscription = bus.subscribe(
            keyexprs.agent_correction(agent), lambda _, payload: self._receive(payload)
        )
        self._thread = machine.thread(self._run, "corrections", daemon=True)
        self._thread.start()

    @property
    def latest(self) -> Correction | None:
        """The newest correction of this session; None before the first."""
        with self._changed:
            return self._latest

    def new_session(self, session: str) -> None:
        """The odometry started anew: what was known of its frame is void."""
        with self._changed:
            self._session = session
            self._latest = None
            self._is_news = False

    def finish_call(self) -> None:
        """Wait for the end of a callback under way; in the callback itself there is no wait."""
        with self._changed:
            if threading.current_thread() is not self._thread:
                self._changed.wait_for(lambda: self._stopping or not self._calling)

    def refresh(self) -> None:
        """Ask for the latest correction: the link was down, publications may have been lost."""
        with self._changed:
            self._asking = True
            self._changed.notify_all()

    def close(self, timeout_s: float) -> None:
        """Call nobody any more; wait so long for a callback or question under way."""
        self._subscription.close()
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout_s)

    def _receive(self, payload: bytes) -> None:
        try:
            correction = codec.decode(payload, Correction)
        except codec.MalformedMessage as error:
            logger.warning("ignoring a malformed correction: %s", error)
            return
        with self._changed:
            meant = (correction.keyframe.agent, correction.keyframe.session)
            if meant == (self._agent, self._session) and supersedes(correction, self._latest):
                self._latest = correction
                self._is_news = True
                self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopping or self._is_news or self._asking)
                if self._stopping:
                    return
                asking, self._asking = self._asking, False
                news, self._is_news = (self._latest if self._is_news else None), False
                self._calling = news is not None
            if news is not None:
                self._call(news)
            if asking:
                self._ask()

    def _ask(self) -> None:
        try:
            replies = self._bus.ask(keyexprs.agent_correction(self._agent))
        except BusClosed:
            return
        for reply in replies:
            self._receive(reply)

    def _call(self, news: Correction) -> None:
        try:
            if self._on_correction is not None:
                self._on_correction(news)
        except Exception:  # the robot's code: its mistake must not end the feed
            logger.exception("the callback for corrections failed")
        with self._changed:
            self._calling = False
            self._changed.notify_all()
