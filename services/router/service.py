"""The router: the hub while it runs, and the roster that it follows."""

from __future__ import annotations

import logging
from contextlib import closing
from datetime import UTC, datetime, timedelta

from covinz.access.roster import Roster, RosterError
from covinz.bus import BusError, Router, open_router
from covinz.service import Context, StatusRequest
from covinz.types import Status

logger = logging.getLogger(__name__)

# Between two looks at the roster. [s]
POLL_S = 1.0
# Who has credentials that end sooner is named in the log at every start.
EXPIRES_SOON = timedelta(days=30)


def run(context: Context) -> None:
    """Route until stopped; raises BusError when it cannot listen, see `open_router`.

    The process is a client of its own router, so that it answers for its state like all others.
    """
    folder = context.config.bus.roster
    roster = None if folder is None else Roster(folder)
    with closing(open_router(context.config.bus)) as router:
        follower = None if roster is None else RosterFollower(roster, router)
        while True:
            event = context.inbox.take(None if follower is None else POLL_S)
            if isinstance(event, StatusRequest):
                event.answer(_status(context.instance))
            if follower is not None:
                follower.look()


class RosterFollower:
    """Makes the router start anew when the roster has changed."""

    def __init__(self, roster: Roster, router: Router) -> None:
        self._roster = roster
        self._router = router
        self._version = roster.version()
        self._say_who_expires()

    def look(self) -> None:
        """Follow a change; raises BusError when the router cannot go on."""
        version = self._roster.version()
        if version == self._version:
            return
        self._version = version
        try:
            self._router.reopen()
        except BusError as error:
            if not self._router.is_open:
                raise
            logger.error("going on with the roster as it was: %s", error)
        else:
            logger.info("the roster has changed; all sessions connect anew")
            self._say_who_expires()

    def _say_who_expires(self) -> None:
        try:
            members = self._roster.read().members
        except RosterError as error:
            logger.error("%s", error)
            return
        for name, member in members.items():
            if member.until < datetime.now(UTC) + EXPIRES_SOON:
                logger.warning(
                    "the credentials of %s end on %s: `covinz roster add %s --replace`",
                    name,
                    f"{member.until:%Y-%m-%d %H:%M} UTC",
                    name,
                )


def _status(instance: str) -> Status:
    return Status(
        service="router",
        instance=instance,
        log_id="",
        cursor=0,
        pending=0,
        leased=0,
        dirty=False,
    )
