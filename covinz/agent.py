"""The robot's side of covinz: send keyframes, receive corrections."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from covinz import codec, keyexprs
from covinz.access.credentials import SUFFIX, agent_bus
from covinz.bus import Bus, ZenohBus, check_size
from covinz.config import BusConfig, Config
from covinz.corrections import CorrectionFeed
from covinz.frames import is_rigid
from covinz.machine import THIS_MACHINE, Machine
from covinz.spool import Spool, SpoolReport
from covinz.spool_rows import SpoolEntry, SpoolRow
from covinz.spool_writer import SpoolWriter
from covinz.types import (
    AGENT_PATTERN,
    ULID_PATTERN,
    Array,
    Correction,
    Keyframe,
    KeyframeContent,
    KeyframeId,
    Rejected,
    RetryAfter,
)
from covinz.ulid import new_ulid
from covinz.uploader import Uploader

logger = logging.getLogger(__name__)


class Agent:
    """A robot in the shared map.

        with Agent("a1", "a1.covinz", "a1.spool") as agent:
            for content in frontend.keyframes():
                agent.send(content)

    Nothing that is on the robot's disk is lost: it stays there until the server has it on its own,
    across failures of link, server and robot. `send` waits for the disk, but only for 10 ms; what
    a slower disk has not taken yet is counted by `unsaved` (usually 0) and would be lost with the
    robot's process. What an earlier run left in the spool is uploaded too.

    Args:
        agent_id: Name of the robot, ``[a-z0-9][a-z0-9_-]{0,31}``; the same at every start.
        bus: Way to the server: the file ``NAME.covinz`` that ``covinz roster add`` wrote there, or
            the endpoint of its router, or a bus, which stays the caller's.
        spool: SQLite file on a disk of the robot.
        config: Configuration; its sections `bus` and `agent` count.
        session: ULID of this run of the odometry; a new one by default.
        on_correction: Called with the latest correction whenever there is a new one, always from
            one thread.
        on_rejected: Called when the server refused a keyframe for good, from an upload thread.
        credentials: File ``NAME.covinz`` for an endpoint that is not the one in it, e.g. QUIC's.
        machine: Clock, chance and threads.

    Raises:
        CredentialsError: If the credentials cannot be read, are another robot's or have expired.
        BusError: If the endpoint is malformed, or needs credentials.
        ValueError: If a name is malformed.
        SpoolError: If the spool cannot be used, e.g. since another process does.

    Source: decision 0027.
    """

    def __init__(
        self,
        agent_id: str,
        bus: Bus | Path | str,
        spool: Path | str,
        config: Config | None = None,
        session: str | None = None,
        on_correction: Callable[[Correction], None] | None = None,
        on_rejected: Callable[[KeyframeId, Rejected], None] | None = None,
        credentials: Path | str | None = None,
        machine: Machine = THIS_MACHINE,
    ) -> None:
        if not AGENT_PATTERN.fullmatch(agent_id):
            raise ValueError(f"not an agent id: {agent_id!r}; expected {AGENT_PATTERN.pattern}")
        self._agent = agent_id
        self._config = config or Config()
        self._machine = machine
        self._on_rejected = on_rejected
        self._resetting = machine.lock()  # writer and feed change their session together
        self._closed = False
        session = _session(session, machine)
        way = _way(agent_id, bus, credentials, self._config)
        with ExitStack() as undo:
            self._spool = Spool(Path(spool), agent_id, self._config.agent, machine)
            undo.callback(self._spool.close)
            self._own_bus = isinstance(way, BusConfig)
            self._bus: Bus = ZenohBus.open(way) if isinstance(way, BusConfig) else way
            if self._own_bus:
                undo.callback(self._bus.close)
            self._uploader = Uploader(
                self._bus, self._spool, agent_id, self._config.agent, self._rejected, machine
            )
            self._writer = SpoolWriter(
                self._spool, session, self._config.agent, self._uploader.hurry, machine
            )
            self._feed = CorrectionFeed(self._bus, agent_id, session, on_correction, machine)
            self._declared = [
                self._bus.declare_alive(keyexprs.agent_alive(agent_id)),
                self._bus.watch_answered(keyexprs.agent_keyframe(agent_id), self._on_ingest),
                self._bus.watch_answered(keyexprs.agent_correction(agent_id), self._on_optimizer),
            ]
            self._writer.start()
            self._uploader.start()
            undo.pop_all()

    @property
    def session(self) -> str:
        """ULID of the current run of the odometry."""
        return self._writer.session

    @property
    def pending(self) -> int:
        """Uploads that the server has not acknowledged."""
        return len(self._spool) + self._writer.unsaved

    @property
    def unsaved(self) -> int:
        """Keyframes that `send` returned for and that a slow disk has not taken yet; usually 0."""
        return self._writer.unsaved

    @property
    def put_off(self) -> RetryAfter | None:
        """Why the server takes nothing now, e.g. since its disk is full, while it says so."""
        return self._uploader.put_off

    def report(self) -> SpoolReport:
        """What waits on the disk, and what had to be given up or was refused since it was made."""
        return self._spool.report()

    @property
    def correction(self) -> Correction | None:
        """The latest correction of this session; None before the first."""
        return self._feed.latest

    @property
    def T_map_odom(self) -> Array | None:
        """(4, 4) where this session's odometry frame is in the shared map; None if unknown."""
        correction = self._feed.latest
        return None if correction is None else correction.T_map_odom

    def send(self, content: KeyframeContent) -> KeyframeId:
        """Hand over a keyframe.

        It is on the robot's disk when this returns, unless the disk takes longer than
        `agent.max_send_wait_s`; then the disk follows (see `unsaved`). Never waits for the
        network, and never longer than 50 ms.

        Raises:
            ValueError: If the keyframe can be of no use; it takes no sequence number then. In
                particular StampError, when it is older than the session's last one, and
                MessageTooLarge.
            SpoolError: If it was not accepted, e.g. since the disk is full.
        """
        if not is_rigid(content.T_odom_body):
            raise ValueError("T_odom_body is not a finite rigid transform")
        return self._writer.put(lambda session, seq: self._entry(session, seq, content))

    def _entry(self, session: str, seq: int, content: KeyframeContent) -> SpoolEntry:
        name = KeyframeId(self._agent, session, seq)
        payload = codec.encode(_keyframe(name, content))
        camera = content.camera
        limits = self._config.agent.max_keyframe_bytes, self._config.bus.max_message_bytes
        check_size(payload, min(limits))
        return SpoolEntry(name, content.stamp_ns, payload, camera.hash, codec.encode(camera))

    def new_session(self) -> str:
        """The odometry was reset: later keyframes begin a new segment; returns its session.

        Waits for a callback under way: none is given a correction of the old session after this.
        """
        with self._resetting:
            session = new_ulid(self._machine)
            self._writer.new_session(session)
            self._feed.new_session(session)
        self._feed.finish_call()  # not inside: the callback may do this too
        return session

    def wait_saved(self, timeout_s: float | None = None) -> bool:
        """Wait until everything sent is on the robot's disk; False when time ran out first."""
        return self._writer.wait_saved(timeout_s)

    def wait_delivered(self, timeout_s: float | None = None) -> bool:
        """Wait until the server has acknowledged everything; False when time ran out first."""
        clock_s = self._machine.monotonic_s
        deadline_s = None if timeout_s is None else clock_s() + timeout_s
        if not self._writer.wait_saved(timeout_s):
            return False
        left_s = None if deadline_s is None else max(0.0, deadline_s - clock_s())
        return self._uploader.wait_empty(left_s)

    def close(self, timeout_s: float = 1.0) -> None:
        """Stop; what is not delivered stays in the spool for the next run.

        Args:
            timeout_s: How long to wait for each of the disk and the answers that are under way.
                It ends a few seconds later at most, whatever hangs.
        """
        if self._closed:
            return
        self._closed = True
        self._writer.stop(timeout_s)
        for declared in self._declared:
            declared.close()
        self._uploader.stop(timeout_s)
        if self._own_bus:
            self._bus.interrupt()
            self._uploader.stop(timeout_s)
        self._feed.close(timeout_s)
        if self._own_bus:
            self._bus.close()
        if not self._spool.close(timeout_s):
            logger.error("the disk hangs; the spool is free again when this process ends")

    def __enter__(self) -> Agent:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _on_ingest(self, there: bool) -> None:
        if there:
            self._uploader.hurry()

    def _on_optimizer(self, there: bool) -> None:
        if there:
            self._feed.refresh()

    def _rejected(self, row: SpoolRow, answer: Rejected) -> None:
        keyframe = KeyframeId(self._agent, row.session, row.first_seq)
        what = f"gap from {keyframe}" if row.is_gap else f"keyframe {keyframe}"
        logger.error("the server refused %s: %s: %s", what, answer.code, answer.reason)
        if self._on_rejected is None or row.is_gap:
            return
        try:
            self._on_rejected(keyframe, answer)
        except Exception:  # the robot's code: its mistake must not end the upload
            logger.exception("the callback for rejections failed")


def _session(session: str | None, machine: Machine) -> str:
    if session is None:
        return new_ulid(machine)
    if not ULID_PATTERN.fullmatch(session):
        raise ValueError(f"not a session (ULID): {session!r}")
    return session


def _way(
    agent_id: str, bus: Bus | Path | str, file: Path | str | None, config: Config
) -> Bus | BusConfig:
    """The caller's bus, or how to open one."""
    if not isinstance(bus, Path | str):
        return bus
    if isinstance(bus, Path) or bus.endswith(SUFFIX):
        return agent_bus(agent_id, config.bus, Path(bus))
    if file is not None:
        return agent_bus(agent_id, config.bus, Path(file), bus)
    return config.bus.model_copy(update={"endpoint": bus})


def _keyframe(name: KeyframeId, content: KeyframeContent) -> Keyframe:
    return Keyframe(
        id=name,
        stamp_ns=content.stamp_ns,
        T_odom_body=content.T_odom_body,
        camera_hash=content.camera.hash,
        features=content.features,
        covariance=content.covariance,
        gravity_body=content.gravity_body,
        thumbnail_jpeg=content.thumbnail_jpeg,
        more_features=content.more_features,
    )
