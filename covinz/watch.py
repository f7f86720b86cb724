"""Notices that a process is stuck, and ends it: whoever supervises starts it again.

Work that must not take for ever is declared with a limit. A thread looks every second; it also
sends the heartbeat by which a supervisor notices what no thread of the process itself can: that
the whole process does not run (SIGSTOP, a frozen container).

Source: decision 0030.
"""

from __future__ import annotations

import faulthandler
import logging
import os
import threading
import time
from collections.abc import Callable
from types import TracebackType

logger = logging.getLogger(__name__)

# Between two looks, and two heartbeats. [s]
TICK_S = 1.0
# A look that comes so late means that nothing here ran, not that work took long. [s]
FROZEN_S = 5.0
# The exit code of a process that ended itself because it was stuck.
STUCK = 70
# The same of one of which a thread has failed.
FAILED = 1


class Work:
    """One kind of work of one thread: ``with work: ...``, or `begin` and `end`.

    Args:
        what: For people, e.g. ``the owner of the inbox``.
        limit_s: It is stuck when it takes longer.
        clock_s: Monotonic time.
    """

    def __init__(self, what: str, limit_s: float, clock_s: Callable[[], float]) -> None:
        self.what = what
        self.limit_s = limit_s
        self._clock_s = clock_s
        self._since_s: float | None = None

    def begin(self) -> None:
        """It begins now."""
        self._since_s = self._clock_s()

    def end(self) -> None:
        """It is done, or waits."""
        self._since_s = None

    def restart(self) -> None:
        """If it is under way it counts from now on."""
        if self._since_s is not None:
            self._since_s = self._clock_s()

    @property
    def lasts_s(self) -> float:
        """How long it has been under way; 0 when it is not."""
        since_s = self._since_s
        return 0.0 if since_s is None else self._clock_s() - since_s

    def __enter__(self) -> None:
        self.begin()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.end()


class Watch:
    """All limited work of a process."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._works: list[Work] = []
        self._looked_s = clock_s()

    def work(self, what: str, limit_s: float) -> Work:
        """Declare a kind of work."""
        declared = Work(what, limit_s, self._clock_s)
        self._works.append(declared)
        return declared

    def overdue(self) -> Work | None:
        """Work that takes longer than its limit, if any."""
        return next((work for work in self._works if work.lasts_s > work.limit_s), None)

    def look(self) -> Work | None:
        """As `overdue`, for who looks every `TICK_S`; time in which nobody could is forgiven."""
        now_s = self._clock_s()
        frozen, self._looked_s = now_s - self._looked_s > FROZEN_S, now_s
        if frozen:
            for work in self._works:
                work.restart()
        return self.overdue()


class Guard:
    """The thread that looks: heartbeats while all is well, the end of the process when not.

    Args:
        watch: What it looks at.
        beat: Called at every look.
        silent_s: When this thread itself is kept from running, by native code that holds the
            interpreter, a timer of the C library ends the process after so long.
        give_up: Ends the process; told which work is stuck.
    """

    def __init__(
        self,
        watch: Watch,
        beat: Callable[[], object],
        silent_s: float,
        give_up: Callable[[Work], object] | None = None,
    ) -> None:
        self._watch = watch
        self._beat = beat
        self._silent_s = silent_s
        self._give_up = give_up or end_process
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="guard", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """Look no more."""
        self._ended.set()
        self._thread.join()
        faulthandler.cancel_dump_traceback_later()

    def _run(self) -> None:
        while True:
            faulthandler.dump_traceback_later(self._silent_s, exit=True)
            stuck = self._watch.look()
            if stuck is not None:
                self._give_up(stuck)
            self._beat()
            if self._ended.wait(TICK_S):
                return


def end_process(stuck: Work) -> None:
    """Say where every thread is and end the process at once."""
    logger.critical(
        "stuck: %s takes %.0f s, at most %.0f s are right; ending, to be started again",
        stuck.what,
        stuck.lasts_s,
        stuck.limit_s,
    )
    faulthandler.dump_traceback(all_threads=True)
    os._exit(STUCK)


def end_with_failed_thread(is_ending: Callable[[], bool]) -> None:
    """Let a thread that fails end its process, which nobody would notice to lack it otherwise.

    Args:
        is_ending: Whether the process ends anyway, and threads may fail for it.
    """

    def failed(arguments: threading.ExceptHookArgs) -> None:
        name = arguments.thread.name if arguments.thread else "a thread"
        error = arguments.exc_value
        logger.critical("%s failed: %r", name, error, exc_info=error)
        if not is_ending():
            os._exit(FAILED)

    threading.excepthook = failed
