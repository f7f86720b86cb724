"""The robots of a case as processes: started, listened to, killed, frozen."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.drill.network import on_other_hardware
from benchmarks.drill.server import CHECKOUT
from covinz.supervisor import child_environment


class RobotFailed(RuntimeError):
    """A robot ended unasked, or did not get on; the message says where to look."""


class RobotProcess:
    """One robot and what it has said.

    Args:
        argv: Its module and arguments.
        log: File for its standard error.
        prefix: Command that it is run by.

    Attributes:
        sent: Ids of the keyframes that `send` has returned for, and their numbers in the
            recording.
        block_ms: How long each call of `send` took.
        refused: Calls of `send` that raised.
    """

    def __init__(self, argv: Sequence[str], log: Path, prefix: Sequence[str] = ()) -> None:
        self.sent: dict[str, int] = {}
        self.block_ms: list[float] = []
        self.refused = 0
        self._log = log
        self._changed = threading.Condition()
        self._open: int | None = None
        self._acked: list[tuple[float, int]] = []
        self._done = self._ended = False
        with log.open("ab") as errors:
            self._process = subprocess.Popen(
                [*prefix, sys.executable, "-m", *argv],
                cwd=CHECKOUT,
                env=child_environment(),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                preexec_fn=on_other_hardware,
            )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def wait_sent(self, count: int, timeout_s: float) -> None:
        """Wait until so many keyframes were handed over; raises RobotFailed."""
        self._wait(lambda: len(self.sent) >= count, f"to send {count} keyframes", timeout_s)

    def wait_done(self, timeout_s: float) -> None:
        """Wait until everything is acknowledged; raises RobotFailed."""
        self._wait(lambda: self._done, "until everything is acknowledged", timeout_s)

    def waiting(self) -> tuple[int, int]:
        """Keyframes handed over now, by earlier runs too, and those not acknowledged yet."""
        with self._changed:
            handed_over = (self._open or 0) + len(self.sent)
            return handed_over, handed_over - (self._acked[-1][1] if self._acked else 0)

    def wait_open(self, timeout_s: float) -> None:
        """Wait until it has begun; raises RobotFailed."""
        self._wait(lambda: self._open is not None, "to begin", timeout_s)

    def when_acked(self, count: int, timeout_s: float) -> float:
        """When so many, of `waiting`, were acknowledged [monotonic s]; raises RobotFailed."""
        reached = lambda: bool(self._acked) and self._acked[-1][1] >= count  # noqa: E731
        self._wait(reached, f"for {count} acknowledgements", timeout_s)
        with self._changed:
            return next(when for when, acked in self._acked if acked >= count)

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self._process.send_signal(number)

    def kill(self) -> None:
        """End it at once and take in what it had still said."""
        self._process.kill()
        self._process.wait()
        self._reader.join()

    def close(self) -> None:
        """Let it end."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()

    def _wait(self, look: Any, what: str, timeout_s: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: look() or self._ended, timeout_s)
            if not look():
                state = "ended" if self._ended else f"waited {timeout_s:.0f} s"
                raise RobotFailed(f"{state}, {what}; see {self._log}")

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            try:
                event = json.loads(line)
            except ValueError:  # cut off by a kill
                continue
            with self._changed:
                self._note(event)
                self._changed.notify_all()
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _note(self, event: dict[str, Any]) -> None:
        match event:
            case {"open": count}:
                self._open = count
            case {"sent": name, "number": number, "block_ms": block_ms}:
                self.sent[name] = number
                self.block_ms.append(block_ms)
            case {"refused": _, "block_ms": block_ms}:
                self.refused += 1
                self.block_ms.append(block_ms)
            case {"acked": count, "t": when}:
                self._acked.append((when, count))
            case {"done": _}:
                self._done = True
