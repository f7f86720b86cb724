"""The way to a server, step by step: credentials, connection, who takes and who gives."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

from covinz import keyexprs
from covinz.access import credentials
from covinz.access.credentials import Credentials, CredentialsError
from covinz.bus import Bus, ZenohBus, endpoints, why_not
from covinz.calibration import CalibrationFile, camera_of
from covinz.config import BusConfig, ConfigError, read_yaml, validate
from covinz.doctor import clocks
from covinz.doctor.agents import of_agent
from covinz.doctor.findings import Finding, Verdict
from covinz.doctor.server import of_server
from covinz.plausibility import complaints

# To connect, and for everybody to be seen. [s]
WAIT_S = 5.0
EXPIRES_SOON = timedelta(days=30)


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
            yield Finding(
                Verdict.BAD,
                f"nobody {what}: {who} is not up on the server",
                "on the server: covinz status, and its log",
            )
            return
    seen = clocks.ask(bus, keyexprs.agent_status(agent), wait_s)
    if seen is not None:
        yield from clocks.version(seen.status)
        yield from clocks.clock(seen)
        yield from of_agent(agent, seen.status)
    replies = bus.ask(keyexprs.agent_correction(agent), timeout_s=wait_s)
    if replies:
        yield Finding(Verdict.GOOD, f"{agent} has been corrected: its keyframes are in a map")
    else:
        yield Finding(
            Verdict.ODD,
            f"no correction yet: no keyframe of {agent} is in a map",
            "the first keyframes make a map a second or two after they came",
        )


def _is_answered(bus: Bus, key: str, wait_s: float) -> bool:
    there = threading.Event()
    with closing(bus.watch_answered(key, lambda answered: there.set() if answered else None)):
        return there.wait(wait_s)


def calibration(path: Path) -> Iterator[Finding]:
    """Look at a calibration file, ``calib.yaml``."""
    try:
        camera = camera_of(validate(CalibrationFile, read_yaml(path), str(path)), str(path))
    except ConfigError as error:
        yield Finding(Verdict.BAD, str(error), "docs/agents.md shows what such a file looks like")
        return
    found = list(complaints(camera))
    for complaint in found:
        yield Finding(Verdict.BAD, f"{path}: {complaint.seen}", complaint.advice)
    if not found:
        size = f"{camera.width} x {camera.height}"
        yield Finding(Verdict.GOOD, f"{path}: a plausible {camera.model} of {size} px")
