"""``python -m services.router``: the Zenoh router as a process; `zenohd` works in its place."""

from __future__ import annotations

from contextlib import closing

from covinz import codec
from covinz.bus import open_router
from covinz.service import Context, StatusRequest, serve
from covinz.types import Status


def run(context: Context) -> None:
    """Route until stopped; raises BusError when somebody else listens on the endpoint.

    The process is a client of its own router, so that it answers for its state like all others.
    """
    with closing(open_router(context.config.bus)):
        while True:
            event = context.inbox.take(None)
            if isinstance(event, StatusRequest):
                event.query.reply(codec.encode(_status(context.instance)))


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


if __name__ == "__main__":
    serve("router", run)
