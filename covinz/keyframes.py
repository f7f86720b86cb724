"""Where keyframes and calibrations come from: the store's protocol, and ingest's over the bus."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from covinz import codec, keyexprs
from covinz.bus import Bus
from covinz.types import Camera, Keyframe, KeyframeId

K = TypeVar("K")
V = TypeVar("V")
T = TypeVar("T", Keyframe, Camera)


class KeyframeNotFound(LookupError):
    """The store has no such keyframe; asking again changes nothing."""


class CameraNotFound(LookupError):
    """The store has no such calibration; asking again changes nothing."""


class StoreUnavailable(RuntimeError):
    """The store gave no usable answer; ask again later."""


class KeyframeStore(Protocol):
    """Gives keyframes with their features, and calibrations."""

    def keyframe(self, keyframe_id: KeyframeId) -> Keyframe:
        """One keyframe; raises KeyframeNotFound or StoreUnavailable."""

    def camera(self, camera_hash: str) -> Camera:
        """One calibration; raises CameraNotFound or StoreUnavailable."""


class RemoteKeyframeStore:
    """Asks ingest and remembers what was used last; for any number of threads.

    It does not repeat a question by itself: the caller knows how long waiting makes sense.

    Args:
        bus: Way to ingest.
        capacity: Keyframes to remember, and as many calibrations.
    """

    def __init__(self, bus: Bus, capacity: int) -> None:
        self._bus = bus
        self._keyframes: _Recent[KeyframeId, Keyframe] = _Recent(capacity)
        self._cameras: _Recent[str, Camera] = _Recent(capacity)

    def keyframe(self, keyframe_id: KeyframeId) -> Keyframe:
        """See `KeyframeStore.keyframe`; BusClosed when the bus ends meanwhile."""
        return self._keyframes.get(keyframe_id, self._fetch_keyframe)

    def camera(self, camera_hash: str) -> Camera:
        """See `KeyframeStore.camera`; BusClosed when the bus ends meanwhile."""
        return self._cameras.get(camera_hash, self._fetch_camera)

    def _fetch_keyframe(self, keyframe_id: KeyframeId) -> Keyframe:
        payload = self._ask(keyexprs.keyframe(keyframe_id))
        if not payload:
            raise KeyframeNotFound(f"no keyframe {keyframe_id}")
        keyframe = _decoded(payload, Keyframe)
        if keyframe.id != keyframe_id:
            raise StoreUnavailable(f"asked for {keyframe_id}, got {keyframe.id}")
        return keyframe

    def _fetch_camera(self, camera_hash: str) -> Camera:
        payload = self._ask(keyexprs.camera(camera_hash))
        if not payload:
            raise CameraNotFound(f"no camera {camera_hash}")
        camera = _decoded(payload, Camera)
        if camera.hash != camera_hash:
            raise StoreUnavailable(f"asked for camera {camera_hash}, got {camera.hash}")
        return camera

    def _ask(self, key: str) -> bytes:
        """The answer; empty when the store has no such thing."""
        replies = self._bus.ask(key)
        if not replies:
            raise StoreUnavailable(f"nobody answered {key}")
        return replies[0]


class _Recent(Generic[K, V]):
    """The values used last, at most `capacity`."""

    def __init__(self, capacity: int) -> None:
        if capacity < 1:
            raise ValueError(f"capacity must be positive, not {capacity}")
        self._capacity = capacity
        self._lock = threading.Lock()
        self._values: OrderedDict[K, V] = OrderedDict()

    def get(self, key: K, fetch: Callable[[K], V]) -> V:
        """The value, fetched if it is not here. What `fetch` raises is not remembered."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
        value = fetch(key)  # without the lock: it takes long, and others may have what they need
        with self._lock:
            self._values[key] = value
            self._values.move_to_end(key)
            while len(self._values) > self._capacity:
                self._values.popitem(last=False)
        return value


def _decoded(payload: bytes, kind: type[T]) -> T:
    try:
        return codec.decode(payload, kind)
    except codec.MalformedMessage as error:
        raise StoreUnavailable(f"unreadable answer: {error}") from error
