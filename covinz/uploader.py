"""Upload of a spool: a window of acknowledged queries that outlives every failure of the server."""

from __future__ import annotations

import logging
import random
from collections import Counter
from collections.abc import Callable

from covinz import codec, keyexprs
from covinz.bus import Bus, BusClosed, MessageTooLarge
from covinz.config import AgentConfig
from covinz.machine import THIS_MACHINE, Machine
from covinz.spool import Spool, SpoolError
from covinz.spool_rows import SpoolRow
from covinz.types import Duplicate, NeedCamera, Rejected, RetryAfter, Stored, UploadReply

logger = logging.getLogger(__name__)

# An upload that timed out so often lets newer ones go first: something may be wrong with it alone.
_PATIENCE = 3
# So many such rows are watched at once.
_MAX_SUSPECTS = 100
# The longest pause that an overloaded server may ask for. [s]
_MAX_OVERLOAD_S = 60.0


class _NoAnswer(Exception):
    """An upload of which nothing is known."""


class Backoff:
    """Pauses between failures: doubling, with jitter so that a fleet does not come back at once."""

    def __init__(self, config: AgentConfig, draw: random.Random) -> None:
        self._min_s, self._max_s = config.min_backoff_s, config.max_backoff_s
        self._draw = draw
        self._next_s = self._min_s

    def failed(self) -> float:
        """How long to pause now [s]: between half and all of the current step."""
        pause_s = self._next_s * self._draw.uniform(0.5, 1.0)
        self._next_s = min(2 * self._next_s, self._max_s)
        return pause_s

    def asked(self, seconds: float) -> float:
        """How long to pause when the server asked for so many [s]: up to a quarter longer."""
        return max(seconds * self._draw.uniform(1.0, 1.25), self.failed())

    def reset(self) -> None:
        """The server is there."""
        self._next_s = self._min_s


class Uploader:
    """Sends what is in the spool, oldest first, until each row is acknowledged or refused.

    `config.window` uploads are under way at once. After a failure there is one probe at a time,
    with growing pauses, until one succeeds.

    Attributes:
        put_off: Why the server takes nothing now, while it says so.

    Args:
        bus: Way to the server.
        spool: What is to be sent.
        agent: Whose spool it is.
        config: Window, time-outs, pauses.
        on_rejected: Called from an upload thread when the server refused a row for good.
        machine: Clock, threads and jitter.
    """

    def __init__(
        self,
        bus: Bus,
        spool: Spool,
        agent: str,
        config: AgentConfig,
        on_rejected: Callable[[SpoolRow, Rejected], None],
        machine: Machine = THIS_MACHINE,
    ) -> None:
        self._bus = bus
        self._spool = spool
        self._agent = agent
        self._config = config
        self._on_rejected = on_rejected
        self._clock_s = machine.monotonic_s
        self._changed = machine.condition()  # guards what follows
        self._stopping = False
        self._under_way = 0
        self._news = 0  # counts whatever may have changed what can be sent
        self._failing = False
        self._resume_at = 0.0  # no upload before this time of the monotonic clock
        self._may_hurry = True  # whether news may end the pause early
        self._backoff = Backoff(config, random.Random(machine.random_bytes(8)))
        self.put_off: RetryAfter | None = None
        self._strikes: Counter[int] = Counter()  # by position: what speaks against the row
        self._registering = machine.lock()  # one thread registers a camera, the others wait
        self._registered: set[str] = set()
        self._threads = [
            machine.thread(self._run, f"upload-{i}", daemon=True) for i in range(config.window)
        ]

    def start(self) -> None:
        """Begin to send."""
        for thread in self._threads:
            thread.start()

    def hurry(self) -> None:
        """There is something new, or the server is back: do not wait for the end of a pause."""
        with self._changed:
            if self._may_hurry:
                self._resume_at = 0.0
            self._tell()

    def wait_empty(self, timeout_s: float | None) -> bool:
        """Wait until the spool is empty; False when time ran out first or after `stop`."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopping or not len(self._spool), timeout_s)
            return not self._stopping and not len(self._spool)

    def stop(self, timeout_s: float) -> None:
        """Send nothing more; wait so long for uploads under way, whose answers are lost then."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        deadline = self._clock_s() + timeout_s
        for thread in self._threads:
            thread.join(max(0.0, deadline - self._clock_s()))

    def _run(self) -> None:
        while (row := self._next()) is not None:
            answer, strikes = self._outcome(row)
            is_settled = self._settle(row, answer)
            if isinstance(answer, Rejected) and not is_settled:
                strikes = _PATIENCE  # the disk did not take it
            self._done(row.position, answer, is_settled, strikes)

    def _outcome(self, row: SpoolRow) -> tuple[UploadReply | None, int]:
        """Send a row: the answer, if there was one, and how much speaks against the row itself."""
        started = self._clock_s()
        try:
            return self._attempt(row), 0
        except _NoAnswer as error:
            logger.debug("%s/%d: %s", row.session, row.first_seq, error)
            timed_out = self._clock_s() - started >= self._config.ack_timeout_s
            return None, int(timed_out)
        except SpoolError as error:
            self._complain("cannot read the calibration of an upload: %s", error)
        except Exception:  # a mistake of ours or of the bus must not end the uploads for good
            logger.exception("an upload failed and will be tried again")
        return None, _PATIENCE

    def _next(self) -> SpoolRow | None:
        """The next row to send, when it is time; None at the end."""
        while True:
            with self._changed:
                if not self._wait_for_turn():
                    return None
                self._under_way += 1
                known = self._news
                suspects = [p for p, strikes in self._strikes.items() if strikes >= _PATIENCE]
            row = self._take(suspects)  # may wait for the disk, so without the lock
            if row is not None:
                return row
            self._wait_for_news(known)

    def _wait_for_news(self, known: int) -> None:
        """There was nothing to send when `known` was all the news: wait for more."""
        with self._changed:
            self._under_way -= 1
            self._changed.notify_all()
            self._changed.wait_for(
                lambda: self._stopping or self._news != known, self._config.max_backoff_s
            )

    def _wait_for_turn(self) -> bool:
        """Wait for the end of a pause and of somebody else's probe; False at the end."""
        while not self._stopping:
            pause_s = self._resume_at - self._clock_s()
            if pause_s > 0:
                self._changed.wait(pause_s)
            elif self._failing and self._under_way:
                self._changed.wait(self._config.max_backoff_s)
            else:
                return True
        return False

    def _tell(self) -> None:
        self._news += 1
        self._changed.notify_all()

    def _take(self, suspects: list[int]) -> SpoolRow | None:
        try:
            return self._spool.take(later=suspects)
        except SpoolError as error:
            logger.error("cannot read what is to be sent: %s", error)
            return None

    def _attempt(self, row: SpoolRow) -> UploadReply:
        """Send a row, and its calibration first where the server lacks it."""
        key = keyexprs.agent_keyframe(self._agent)
        answer = self._register(row.camera_hash) or self._ask(key, row.payload)
        if isinstance(answer, NeedCamera):
            with self._registering:
                self._registered.discard(row.camera_hash)
            answer = self._register(row.camera_hash) or self._ask(key, row.payload)
        return answer

    def _register(self, camera_hash: str) -> UploadReply | None:
        """Make the server know a calibration; None when it does, else why it does not."""
        with self._registering:
            if not camera_hash or camera_hash in self._registered:
                return None
            answer = self._ask(keyexprs.agent_camera(self._agent), self._spool.camera(camera_hash))
            if isinstance(answer, Stored | Duplicate):
                self._registered.add(camera_hash)
                return None
            return answer

    def _ask(self, key: str, payload: bytes) -> UploadReply:
        try:
            replies = self._bus.ask(key, payload, timeout_s=self._config.ack_timeout_s)
        except MessageTooLarge as error:
            return Rejected("too_large", str(error))
        except BusClosed as error:
            raise _NoAnswer(str(error)) from error
        if not replies:
            raise _NoAnswer("nobody there, or too late")
        try:
            return codec.decode_upload_reply(replies[0])
        except codec.MalformedMessage as error:
            raise _NoAnswer(str(error)) from error

    def _settle(self, row: SpoolRow, answer: UploadReply | None) -> bool:
        """Note the outcome in the spool; whether the row is done with."""
        try:
            match answer:
                case Stored() | Duplicate():
                    self._spool.delivered(row.position)
                    return True
                case Rejected():
                    self._spool.rejected(row.position, answer)
                    self._on_rejected(row, answer)
                    return True
        except SpoolError as error:
            self._complain("an upload that was answered will be sent again: %s", error)
        self._spool.release(row.position)
        return False

    def _complain(self, text: str, error: SpoolError) -> None:
        # After `stop` the spool may be closed: then this is the expected end.
        logger.log(logging.DEBUG if self._stopping else logging.ERROR, text, error)

    def _done(
        self, position: int, answer: UploadReply | None, is_settled: bool, strikes: int
    ) -> None:
        with self._changed:
            self._under_way -= 1
            if is_settled:
                self._failing, self.put_off = False, None
                if self._may_hurry:  # a pause that the server asked for is kept
                    self._resume_at = 0.0
                self._backoff.reset()
                self._strikes.pop(position, None)
            else:
                self._pause(answer.seconds if isinstance(answer, RetryAfter) else 0.0)
                self._note_put_off(answer)
                if strikes:
                    self._suspect(position, strikes)
            self._tell()

    def _note_put_off(self, answer: UploadReply | None) -> None:
        if isinstance(answer, RetryAfter):
            if self.put_off is None or self.put_off.reason != answer.reason:
                logger.warning("the server takes nothing of %s now: %s", self._agent, answer.reason)
            self.put_off = answer

    def _pause(self, overload_s: float) -> None:
        """Send nothing for a while: so long as the server asks for, or else the back-off."""
        self._failing = True
        now = self._clock_s()
        if overload_s:
            self._may_hurry = False
            pause_s = self._backoff.asked(min(overload_s, _MAX_OVERLOAD_S))
            self._resume_at = max(self._resume_at, now + pause_s)
        elif now >= self._resume_at:  # uploads that fail together are one failure
            self._may_hurry = True
            self._resume_at = now + self._backoff.failed()

    def _suspect(self, position: int, strikes: int) -> None:
        self._strikes[position] += strikes
        if len(self._strikes) > _MAX_SUSPECTS:  # then it is the link or the disk, not the rows
            self._strikes.clear()
