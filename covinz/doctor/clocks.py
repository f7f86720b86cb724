"""Do the programs and the clocks on both sides go together?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from covinz import codec
from covinz.bus import Bus
from covinz.doctor.findings import Finding, Verdict
from covinz.program import VERSION
from covinz.types import Status

# Clocks further apart are odd: stamps of robots cannot be compared. [s]
MAX_OFFSET_S = 1.0
# Who answers later says little about its clock. [s]
MAX_ROUND_TRIP_S = 5.0


@dataclass(frozen=True, slots=True)
class Answer:
    """A status, and how its sender's clock compares with ours.

    Attributes:
        status: What it said.
        offset_s: Its clock minus ours; None when it did not say.
        within_s: Half the round trip: how wrong `offset_s` may be.
    """

    status: Status
    offset_s: float | None
    within_s: float


def ask(
    bus: Bus, key: str, timeout_s: float, now_ns: Callable[[], int] = time.time_ns
) -> Answer | None:
    """Ask for one status; None when there is no answer in time."""
    asked_ns = now_ns()
    replies = bus.ask(key, timeout_s=timeout_s)
    answered_ns = now_ns()
    if not replies:
        return None
    status = codec.decode(replies[0], Status)
    within_s = 0.5e-9 * (answered_ns - asked_ns)
    offset_s = None
    if status.now_ns is not None:
        offset_s = 1e-9 * (status.now_ns - asked_ns) - within_s
    return Answer(status, offset_s, within_s)


def clock(answer: Answer) -> Iterator[Finding]:
    """Does the server's clock agree with this machine's?"""
    if answer.offset_s is None:
        return
    ahead, within = abs(answer.offset_s), f"± {answer.within_s:.3f} s"
    if ahead > MAX_OFFSET_S + answer.within_s:
        which = "ahead of" if answer.offset_s > 0 else "behind"
        yield Finding(
            Verdict.ODD,
            f"the server's clock is {ahead:.3f} s {which} this machine's ({within})",
            "let both follow the same time (NTP, chrony): keyframes carry this machine's stamps, "
            "and certificates are good from and until a time",
        )
    else:
        yield Finding(Verdict.GOOD, f"the clocks agree within {ahead:.3f} s ({within})")


def version(status: Status) -> Iterator[Finding]:
    """Is the server's program of the same version as this one?"""
    if status.version == VERSION:
        yield Finding(Verdict.GOOD, f"this program and the server are {VERSION}")
        return
    theirs = status.version or "of a version that it does not tell"
    yield Finding(
        Verdict.ODD,
        f"this program is {VERSION}, {status.service} {theirs}",
        "messages only gain fields, so both go on; what only the newer one knows is not used",
    )
