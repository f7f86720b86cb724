"""The calibrations that the log's keyframes name, at hand before the keyframes are."""

from __future__ import annotations

import logging

from covinz.keyframes import CameraNotFound, KeyframeStore, StoreUnavailable
from covinz.machine import THIS_MACHINE, Machine
from covinz.types import Camera, Keyframe, LogPage

logger = logging.getLogger(__name__)

# Between two questions to a store that does not answer. [s]
PAUSE_S = 0.5


class Calibrations:
    """Filled by the thread that follows the log, read by the one that works it off.

    Calibrations are named by their content and ingest logs no keyframe before it has the
    calibration: what is found here is a function of the log.

    Args:
        store: Where they come from.
        pause_s: Between two questions to a store that does not answer.
        machine: To wait.
    """

    def __init__(
        self,
        store: KeyframeStore,
        pause_s: float = PAUSE_S,
        machine: Machine = THIS_MACHINE,
    ) -> None:
        self._store = store
        self._pause_s = pause_s
        self._closed = machine.event()
        self._cameras: dict[str, Camera | None] = {}

    def fetch(self, page: LogPage) -> None:
        """Get what the keyframes of a page need; waits for the store until `close`."""
        for entry in page.entries:
            if isinstance(entry.item, Keyframe) and entry.item.camera_hash not in self._cameras:
                self._fetch(entry.item.camera_hash)

    def camera(self, camera_hash: str) -> Camera | None:
        """A calibration of a keyframe of the log; None when the store has none."""
        return self._cameras.get(camera_hash)

    def forget_missing(self) -> None:
        """Another log follows: what was not there for the last one may be there for it."""
        for name in [name for name, camera in self._cameras.items() if camera is None]:
            del self._cameras[name]

    def close(self) -> None:
        """End the waiting."""
        self._closed.set()

    def _fetch(self, camera_hash: str) -> None:
        while not self._closed.is_set():
            try:
                self._cameras[camera_hash] = self._store.camera(camera_hash)
                return
            except CameraNotFound as error:
                logger.error("keyframes without calibration: %s", error)
                self._cameras[camera_hash] = None
                return
            except StoreUnavailable as error:
                logger.warning("waiting for calibration %s: %s", camera_hash, error)
                self._closed.wait(self._pause_s)
