"""Rendered images on disk: made once, the same bits every time, never more than a few gigabytes.

A file is a JPEG (any viewer opens it) with a checksum behind it. Its name is a digest of all that
the image depends on, so that it is never stale. Processes may share the folder.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

# The folder is cut back to this size, the images not used for longest first. One of 752 x 480
# takes some 200 kB. [bytes]
MAX_BYTES = 4 * 1024**3
# What the image is, not only how it is kept: an image that was just rendered goes through the
# same coding, as in a camera that sends JPEG.
_QUALITY = 95
_CHECKSUM_BYTES = 16


class ImageCache:
    """Images by name.

    Args:
        folder: Where; it exists.
        max_bytes: What `prune` cuts the folder back to.
    """

    def __init__(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        self._folder = folder
        self._max_bytes = max_bytes

    def __contains__(self, key: str) -> bool:
        """Whether an image is there and whole."""
        return self._jpeg(key) is not None

    def read(self, key: str) -> NDArray[np.uint8] | None:
        """An image (H, W, 3) BGR; None where there is none that is whole."""
        jpeg = self._jpeg(key)
        if jpeg is None:
            return None
        image = cv2.imdecode(np.frombuffer(jpeg, dtype=np.uint8), cv2.IMREAD_COLOR)
        return None if image is None else np.asarray(image, dtype=np.uint8)

    def write(self, key: str, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Keep an image (H, W, 3) BGR; returns it as `read` will.

        Raises:
            OSError: If it cannot be written, e.g. since the disk is full.
        """
        _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        jpeg = coded.tobytes()
        # Written beside and renamed: nobody ever sees half a file under its name.
        descriptor, beside = tempfile.mkstemp(prefix=".", dir=self._folder)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(jpeg + _checksum(jpeg))
            os.replace(beside, self._path(key))
        except BaseException:
            Path(beside).unlink(missing_ok=True)
            raise
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=np.uint8)

    def prune(self) -> None:
        """Remove the images not used for longest, until the rest fits."""
        found = []
        for path in self._folder.glob("*.jpg"):
            try:
                about = path.stat()
            except FileNotFoundError:  # another process prunes too
                continue
            found.append((about.st_mtime_ns, about.st_size, path))
        excess = sum(size for _, size, _ in found) - self._max_bytes
        for _, size, path in sorted(found):
            if excess <= 0:
                break
            path.unlink(missing_ok=True)
            excess -= size

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.jpg"

    def _jpeg(self, key: str) -> bytes | None:
        """The coded image if it is whole; notes that it was used."""
        path = self._path(key)
        try:
            data = path.read_bytes()
            os.utime(path)
        except OSError:
            return None
        jpeg, checksum = data[:-_CHECKSUM_BYTES], data[-_CHECKSUM_BYTES:]
        return jpeg if checksum == _checksum(jpeg) else None


def _checksum(jpeg: bytes) -> bytes:
    return hashlib.blake2b(jpeg, digest_size=_CHECKSUM_BYTES).digest()
