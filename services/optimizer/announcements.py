"""What robots are told: corrections are made, made durable, and only then published."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from covinz import codec, keyexprs
from covinz.bus import Bus
from covinz.config import OptimizerConfig
from covinz.types import Correction, SegmentId
from services.optimizer.corrections import make_correction
from services.optimizer.loop_store import LoopStore
from services.optimizer.maps import Maps
from services.optimizer.unsent import Encoded, Unsent


class Announcements:
    """The last correction of each robot and those on their way; for one thread.

    Args:
        store: Keeps them.
        unsent: Those that wait for the store.
        bus: To publish them.
        config: Says what a jump is.
        now_ns: Time since the Unix epoch, for stamps.

    Attributes:
        jumps: How many corrections moved a robot further than the configured limits.
    """

    def __init__(
        self,
        store: LoopStore,
        unsent: Unsent,
        bus: Bus,
        config: OptimizerConfig,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._store = store
        self._unsent = unsent
        self._bus = bus
        self._config = config
        self._now_ns = now_ns
        self._last = {c.keyframe.agent: c for c in store.corrections()}
        # Of all logs: robots take no correction that is older than the one they have.
        self._last_stamp_ns = max((c.stamp_ns for c in self._last.values()), default=0)
        self._waiting: set[SegmentId] = set()
        self.jumps = 0

    @property
    def last(self) -> Mapping[str, Correction]:
        """What was published last, by agent."""
        return self._last

    def begin_log(self, is_other: bool) -> None:
        """A log is read from its beginning; what was said of another one is forgotten."""
        self._waiting.clear()
        if is_other:
            self._last.clear()
            self._unsent.clear()

    def expect(self, segment: SegmentId) -> None:
        """A robot's newest segment has become this one, and it has no correction yet."""
        self._waiting.add(segment)

    def introduce(self, maps: Maps, now_s: float) -> None:
        """First corrections; not before a segment's map shows what is known of it."""
        if not self._waiting:
            return
        stale = {name for segments, _ in maps.stale(with_keyframes=False) for name in segments}
        if ready := self._waiting - stale:
            self.prepare(maps, self._store.revision, ready, now_s)

    def prepare(self, maps: Maps, revision: int, segments: set[SegmentId], now_s: float) -> None:
        """Corrections to the robots whose newest segment is among `segments`, for the store."""
        corrections: dict[str, Encoded] = {}
        stamp_ns = max(self._now_ns(), self._last_stamp_ns)
        for segment in maps.newest_segments():
            found = maps.placement(segment)
            if segment in segments and found is not None:
                previous = self._unsent.of(segment.agent) or self._last.get(segment.agent)
                made = make_correction(*found, previous, self._config, stamp_ns)
                corrections[segment.agent] = Encoded(made, codec.encode(made))
        payloads = {agent: encoded.payload for agent, encoded in corrections.items()}
        self._unsent.write(lambda: self._store.publish(revision, payloads), now_s)
        self._waiting -= segments
        for agent, encoded in corrections.items():
            self._unsent.add(agent, encoded)
            self._last_stamp_ns = max(self._last_stamp_ns, encoded.correction.stamp_ns + 1)
            self.jumps += encoded.correction.jumped

    def send(self, now_s: float) -> None:
        """Publish what is durable."""
        for encoded in self._unsent.take(now_s):
            agent = encoded.correction.keyframe.agent
            self._last[agent] = encoded.correction
            self._bus.put(keyexprs.agent_correction(agent), encoded.payload)
