"""What ingest has seen of each agent since it was started: answers why nothing arrives.

Read by `covinz doctor`; nothing depends on it.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

from covinz import codec, frames, keyexprs
from covinz.bus import Query
from covinz.machine import THIS_MACHINE, Machine
from covinz.plausibility import complaints
from covinz.program import VERSION
from covinz.types import Camera, Keyframe, Status

# Agents that are remembered; names that nobody has may be made up without end.
MAX_AGENTS = 1000
# Keyframes whose way from camera to log is looked at: the fastest tells the clocks apart.
RECENT = 32
# A keyframe that moved less than this since the one before shows nothing new. [m, rad]
STILL_M, STILL_RAD = 0.01, 0.01


@dataclass(slots=True, eq=False)
class _Page:
    """Of one agent."""

    counts: Counter[str] = field(default_factory=Counter)
    ages_s: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    arrived_ns: int = 0
    last: Keyframe | None = None


class AgentBook:
    """Notes what came; for any number of threads.

    Args:
        instance: Name in the answers.
        min_features: A keyframe with fewer cannot take part in place recognition.
        machine: Wall clock.
    """

    def __init__(self, instance: str, min_features: int, machine: Machine = THIS_MACHINE) -> None:
        self._instance = instance
        self._min_features = min_features
        self._machine = machine
        self._lock = threading.Lock()  # never waits for anything, also not in the simulation
        self._pages: dict[str, _Page] = {}

    def stored(self, kf: Keyframe) -> None:
        """A keyframe is in the log."""
        now_ns = self._machine.now_ns()
        with self._lock:
            page = self._page(kf.id.agent)
            if page is None:
                return
            page.arrived_ns = now_ns
            page.ages_s.append(1e-9 * (now_ns - kf.stamp_ns))
            page.counts["keyframes"] += 1
            num_features = sum(len(block) for block in kf.all_features)
            page.counts["few_features"] += num_features < self._min_features
            last, page.last = page.last, codec.without_features(kf)
            if last is None or last.id.session != kf.id.session:
                page.counts["sessions"] += 1
                return
            forward = kf.id.seq - last.id.seq
            page.counts["stamps_back"] += forward * (kf.stamp_ns - last.stamp_ns) < 0
            page.counts["still"] += _is_still(last, kf)

    def refused(self, agent: str, code: str) -> None:
        """An upload was rejected."""
        with self._lock:
            if (page := self._page(agent)) is not None:
                page.counts[f"rejected.{code}"] += 1

    def registered(self, agent: str, camera: Camera) -> None:
        """A calibration was registered."""
        with self._lock:
            if (page := self._page(agent)) is not None:
                for complaint in complaints(camera):
                    page.counts[f"odd_calibration.{complaint.code}"] += 1

    def answer(self, query: Query) -> None:
        """Answer `keyexprs.agent_status` with the status of ingest for this agent."""
        try:
            agent = keyexprs.agent_of(query.key)
        except ValueError:
            query.drop()
            return
        query.reply(codec.encode(self.status(agent)))

    def status(self, agent: str) -> Status:
        """What was seen of an agent since the start; zeros of one that is not known."""
        now_ns = self._machine.now_ns()
        with self._lock:
            page = self._pages.get(agent, _Page())
            numbers = {name: float(count) for name, count in page.counts.items()}
            if page.ages_s:
                numbers["since_last_keyframe_s"] = 1e-9 * (now_ns - page.arrived_ns)
                numbers["youngest_keyframe_s"] = min(page.ages_s)
            keyframes = page.counts["keyframes"]
        return Status(
            service="ingest",
            instance=self._instance,
            log_id="",
            cursor=keyframes,
            pending=0,
            leased=0,
            dirty=False,
            counters=numbers,
            version=VERSION,
            now_ns=now_ns,
        )

    def _page(self, agent: str) -> _Page | None:
        if agent not in self._pages and len(self._pages) < MAX_AGENTS:
            self._pages[agent] = _Page()
        return self._pages.get(agent)


def _is_still(last: Keyframe, kf: Keyframe) -> bool:
    step = frames.inverse(last.T_odom_body) @ kf.T_odom_body
    moved_m, turned_rad = np.linalg.norm(step[:3, 3]), float(frames.rotation_angle(step))
    return bool(moved_m < STILL_M and turned_rad < STILL_RAD)
