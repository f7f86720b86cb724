"""SIGINT and SIGTERM as an event that a program waits for."""

from __future__ import annotations

import queue
import signal
import threading
from types import FrameType


def stop_event() -> threading.Event:
    """An event that is set when the process is asked to stop; call it in the main thread.

    A handler runs in the middle of whatever the main thread does, perhaps in a wait for this very
    event, whose lock it then holds. So the handler only puts into a queue, which is made for that,
    and a thread sets the event.
    """
    stop = threading.Event()
    asked: queue.SimpleQueue[int] = queue.SimpleQueue()

    def note(number: int, _: FrameType | None) -> None:
        asked.put(number)

    def wait() -> None:
        asked.get()
        stop.set()

    threading.Thread(target=wait, name="signals", daemon=True).start()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, note)
    return stop
