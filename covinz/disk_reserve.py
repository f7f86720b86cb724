"""Room on the disk that is kept for cleaning up when all else is full.

To delete from a SQLite file needs room too: for its log, and to bring that into the file.
"""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


class DiskReserve:
    """A file of zeros that can be given up and taken again.

    Args:
        path: The file.
        size: How much room. [bytes]
    """

    def __init__(self, path: Path, size: int) -> None:
        self._path = path
        self._size = size
        self._is_held = False

    def take(self) -> bool:
        """Hold the room; False when the disk has not so much.

        Where a file system cannot reserve room for other reasons, it goes without.
        """
        if self._is_held:
            return True
        try:
            with self._path.open("wb") as stream:
                os.posix_fallocate(stream.fileno(), 0, self._size)
        except OSError as error:
            self.give_up()
            return error.errno not in _NO_ROOM
        self._is_held = True
        return True

    def give_up(self) -> None:
        """Let others have the room."""
        self._is_held = False
        with suppress(OSError):
            self._path.unlink(missing_ok=True)
