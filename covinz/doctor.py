"""Why nothing arrives: looks at the way to a server step by step and says what it finds."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path

from covinz import client, keyexprs
from covinz.access import credentials
from covinz.access.credentials import Credentials, CredentialsError
from covinz.bus import Bus, ZenohBus, endpoints, why_not
from covinz.config import BusConfig
from covinz.types import Status

# To connect, and for everybody to be seen. [s]
WAIT_S = 5.0
# Until all tokens that are there have come; nothing says which is the last. [s]
SETTLE_S = 1.0
EXPIRES_SOON = timedelta(days=30)
# Without one of these nothing goes on; loop solvers have a number in their names.
SERVICES = ("router", "ingest", "place_recognition", "loop_solver", "optimizer")


class Verdict(StrEnum):
    """What a finding means."""

    GOOD = "good"
    ODD = "odd"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at, in words for a person."""

    verdict: Verdict
    text: str


def examine(config: BusConfig) -> Iterator[Finding]:
    """Look at credentials, connection and who answers; ends after what makes the rest pointless.

    With a robot's credentials it sees what that robot sees; without, or with an operator's, the
    processes of the server and what they count.
    """
    own: Credentials | None = None
    if config.credentials is not None:
        own, finding = _credentials(config.credentials)
        yield finding
        if own is None or finding.verdict is Verdict.BAD:
            return
    elif endpoints.parse(config.endpoint).is_encrypted:
        yield Finding(
            Verdict.BAD, f"{config.endpoint} needs credentials: --credentials NAME.covinz"
        )
        return
    with closing(ZenohBus.open(config, wait_s=WAIT_S)) as bus:
        if not bus.wait_connected(0.0):
            yield Finding(Verdict.BAD, f"no way to {config.endpoint}: {why_not(config)}")
            return
        yield Finding(Verdict.GOOD, f"connected to {config.endpoint}")
        yield from of_robot(bus, own.name) if own and own.role == "agent" else of_server(bus)


def _credentials(path: Path) -> tuple[Credentials | None, Finding]:
    try:
        own = credentials.read(path)
    except CredentialsError as error:
        return None, Finding(Verdict.BAD, str(error))
    left = own.until - datetime.now(UTC)
    what = f"{path}: credentials of {own.name} ({own.role})"
    if own.is_expired:
        return own, Finding(Verdict.BAD, f"{what} expired on {own.until:%Y-%m-%d %H:%M} UTC")
    verdict = Verdict.GOOD if left > EXPIRES_SOON else Verdict.ODD
    return own, Finding(verdict, f"{what}, good for {left.days} days")


def of_robot(bus: Bus, agent: str, wait_s: float = WAIT_S) -> Iterator[Finding]:
    """What a robot needs: somebody who takes its uploads and corrects it."""
    for key, who, what in (
        (keyexprs.agent_keyframe(agent), "ingest", "takes uploads"),
        (keyexprs.agent_correction(agent), "optimizer", "gives corrections"),
    ):
        if _is_answered(bus, key, wait_s):
            yield Finding(Verdict.GOOD, f"{who} {what}")
        else:
            yield Finding(Verdict.BAD, f"nobody {what}: {who} is not up on the server")
            return
    replies = bus.ask(keyexprs.agent_correction(agent), timeout_s=wait_s)
    if replies:
        yield Finding(Verdict.GOOD, f"{agent} has been corrected: its keyframes are in a map")
    else:
        yield Finding(Verdict.ODD, f"no correction yet: no keyframe of {agent} is in a map")


def _is_answered(bus: Bus, key: str, wait_s: float) -> bool:
    there = threading.Event()
    with closing(bus.watch_answered(key, lambda answered: there.set() if answered else None)):
        return there.wait(wait_s)


def of_server(bus: Bus, settle_s: float = SETTLE_S) -> Iterator[Finding]:
    """What an operator sees: every process, what waits, and what each robot sent."""
    found = client.statuses(bus)
    names = {status.service for status in found}
    for name in SERVICES:
        if name not in names:
            yield Finding(Verdict.BAD, f"{name} does not answer")
    if not found:
        return
    yield Finding(Verdict.GOOD, f"{len(found)} processes answer: {', '.join(sorted(names))}")
    log_ids = {status.log_id for status in found if status.log_id}
    if len(log_ids) > 1:
        yield Finding(Verdict.ODD, "not all have begun to follow the log of this ingest yet")
    now = client.progress(bus)
    yield Finding(Verdict.GOOD, "nothing waits" if now.idle else f"at work: {now}")
    for status in found:
        if status.service == "ingest":
            yield from _robots(status, _alive(bus, settle_s))


def _robots(ingest: Status, alive: set[str]) -> Iterator[Finding]:
    """What each robot sent, and what was refused."""
    per_robot = {
        name.removeprefix("keyframes."): count
        for name, count in ingest.counters.items()
        if name.startswith("keyframes.")
    }
    for robot in sorted(alive | per_robot.keys()):
        count = per_robot.get(robot, 0)
        here = "connected" if robot in alive else "not connected"
        verdict = Verdict.GOOD if count else Verdict.ODD
        yield Finding(verdict, f"{robot}: {here}, {count:g} keyframes stored")
    if not alive | per_robot.keys():
        yield Finding(Verdict.ODD, "no robot has ever connected or sent anything")
    for name, count in sorted(ingest.counters.items()):
        if name.startswith("rejected."):
            code = name.removeprefix("rejected.")
            yield Finding(
                Verdict.BAD, f"{count:g} uploads refused: {code}; ingest's log names whose"
            )


def _alive(bus: Bus, settle_s: float) -> set[str]:
    """Robots that hold their token."""
    seen: set[str] = set()
    settled = threading.Event()

    def see(key: str, is_alive: bool) -> None:
        if is_alive:
            seen.add(keyexprs.agent_of(key))

    with closing(bus.watch_alive(keyexprs.AGENTS_ALIVE, see)):
        settled.wait(settle_s)
    return set(seen)


def is_well(findings: list[Finding]) -> bool:
    """Whether nothing was found that keeps keyframes from arriving."""
    return all(finding.verdict is not Verdict.BAD for finding in findings)
