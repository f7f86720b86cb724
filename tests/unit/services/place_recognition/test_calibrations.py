from __future__ import annotations

import threading

import numpy as np

from covinz.keyframes import CameraNotFound, KeyframeNotFound, StoreUnavailable
from covinz.types import Camera, Gap, Keyframe, KeyframeId, LogEntry, LogPage
from services.place_recognition.calibrations import Calibrations

SESSION = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
CAMERA = Camera("PINHOLE", 640, 480, np.array([500.0, 500.0, 319.5, 239.5]), np.eye(4))


class Store:
    """Has one camera; does not answer the first questions."""

    def __init__(self, times_away: int = 0) -> None:
        self.times_away = times_away
        self.asked: list[str] = []
        self.was_asked = threading.Event()

    def keyframe(self, keyframe_id: KeyframeId) -> Keyframe:
        raise KeyframeNotFound(f"no keyframe {keyframe_id}")

    def camera(self, camera_hash: str) -> Camera:
        self.asked.append(camera_hash)
        self.was_asked.set()
        if len(self.asked) <= self.times_away:
            raise StoreUnavailable("ingest does not answer")
        if camera_hash != CAMERA.hash:
            raise CameraNotFound(f"no camera {camera_hash}")
        return CAMERA


def page(*hashes: str) -> LogPage:
    entries = [
        LogEntry(seq, Keyframe(KeyframeId("a", SESSION, seq), seq, np.eye(4), camera_hash, None))
        for seq, camera_hash in enumerate(hashes)
    ]
    gap = LogEntry(len(entries), Gap("a", SESSION, 90, 91, "spool overflow"))
    return LogPage(SESSION, len(entries) + 1, (*entries, gap))


def test_every_calibration_is_asked_for_once() -> None:
    store = Store()
    calibrations = Calibrations(store)
    assert calibrations.camera(CAMERA.hash) is None
    for _ in range(2):
        calibrations.fetch(page(CAMERA.hash, "f" * 16, CAMERA.hash))
    assert store.asked == [CAMERA.hash, "f" * 16]
    assert calibrations.camera(CAMERA.hash) is CAMERA
    assert calibrations.camera("f" * 16) is None


def test_a_store_that_is_away_is_asked_again() -> None:
    store = Store(times_away=3)
    calibrations = Calibrations(store, pause_s=1e-3)
    calibrations.fetch(page(CAMERA.hash))
    assert len(store.asked) == 4
    assert calibrations.camera(CAMERA.hash) is CAMERA


def test_closing_ends_the_wait() -> None:
    store = Store(times_away=10**9)
    calibrations = Calibrations(store, pause_s=3600.0)
    thread = threading.Thread(target=calibrations.fetch, args=(page(CAMERA.hash),), daemon=True)
    thread.start()
    assert store.was_asked.wait(20)
    calibrations.close()
    thread.join(20)
    assert not thread.is_alive()
    assert calibrations.camera(CAMERA.hash) is None


def test_with_another_log_what_was_missing_is_asked_for_again() -> None:
    store = Store()
    calibrations = Calibrations(store)
    calibrations.fetch(page(CAMERA.hash, "f" * 16))
    calibrations.forget_missing()
    calibrations.fetch(page(CAMERA.hash, "f" * 16))
    assert store.asked == [CAMERA.hash, "f" * 16, "f" * 16]
