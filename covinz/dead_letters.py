"""Uploads that the server refused for good, as files next to the spool: payload and reason.

``a1.sqlite.rejected/SESSION-SEQ.keyframe`` is the message as it was sent, ``SESSION-SEQ.json`` says
why it was refused and when. ``covinz spool a1.sqlite`` lists them and can send them again.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

_REASON = ".json"
# What a file takes on the disk at least. [bytes]
_BLOCK = 4096


@dataclass(frozen=True, slots=True)
class DeadLetter:
    """One refused upload.

    Attributes:
        agent: Who sent it.
        session: Session of the keyframe or gap.
        is_gap: Whether it is a gap.
        first_seq: The keyframe, or the first of the gap.
        last_seq: The same, or the last of the gap.
        camera_hash: Calibration of the keyframe; empty for a gap.
        code: Why it was refused: `Rejected.code`.
        reason: The same for a person.
        refused_at: When, by the robot's clock; ISO 8601, UTC.
    """

    agent: str
    session: str
    is_gap: bool
    first_seq: int
    last_seq: int
    camera_hash: str
    code: str
    reason: str
    refused_at: str

    @property
    def name(self) -> str:
        """File name of its message."""
        return f"{self.session}-{self.first_seq}.{'gap' if self.is_gap else 'keyframe'}"


class DeadLetters:
    """The folder; the oldest make way when it grows too large.

    Methods raise OSError when the disk fails, and then may be called again. What is not ours in
    the folder is left alone.

    Args:
        folder: Made when the first one comes.
        max_bytes: What all take on the disk; the newest is kept in any case.
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self.folder = folder
        self._max_bytes = max_bytes

    def put(self, letter: DeadLetter, payload: bytes) -> None:
        """Keep an upload; it is on the disk when this returns. The same one may come again."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._make_room(letter, len(payload))
        _write(self.folder / letter.name, payload)
        # Last, for a letter is what has a reason.
        text = json.dumps(asdict(letter), indent=2) + "\n"
        _write(self.folder / (letter.name + _REASON), text.encode())
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def letters(self) -> list[DeadLetter]:
        """All that is kept, in the order in which it was refused."""
        found = [_read(file) for file in self.folder.glob(f"*{_REASON}")]
        return sorted(filter(None, found), key=lambda x: (x.refused_at, x.session, x.first_seq))

    def payload(self, letter: DeadLetter) -> bytes:
        """The message of a letter."""
        return (self.folder / letter.name).read_bytes()

    def remove(self, letter: DeadLetter) -> None:
        """Forget a letter; nothing happens when it is gone."""
        (self.folder / (letter.name + _REASON)).unlink(missing_ok=True)
        (self.folder / letter.name).unlink(missing_ok=True)

    def _make_room(self, new: DeadLetter, size: int) -> None:
        kept = [letter for letter in self.letters() if letter.name != new.name]
        sizes = [_size(self.folder / letter.name) for letter in kept]
        total = sum(sizes) + _on_disk(size)
        for letter, letter_size in zip(kept, sizes, strict=True):
            if total <= self._max_bytes:
                return
            self.remove(letter)
            total -= letter_size


def now_text(now_ns: int) -> str:
    """A time as text: ISO 8601, UTC, microseconds."""
    return datetime.fromtimestamp(now_ns // 1000 / 1e6, UTC).isoformat(timespec="microseconds")


def _size(file: Path) -> int:
    return _on_disk(file.stat().st_size if file.exists() else 0)


def _on_disk(size: int) -> int:
    """What a message and its reason take, in whole blocks."""
    return (-(-size // _BLOCK) + 1) * _BLOCK


def _read(file: Path) -> DeadLetter | None:
    """The letter of a file with a reason; None when the file is something else."""
    try:
        values: dict[str, Any] = json.loads(file.read_bytes())
        letter = DeadLetter(**values)
    except (ValueError, TypeError):
        return None
    return letter if file.name == letter.name + _REASON else None


def _write(file: Path, content: bytes) -> None:
    """Write a file as a whole or not at all."""
    part = file.with_name(file.name + ".part")
    with part.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    part.replace(file)
