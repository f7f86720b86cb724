"""Refused uploads as files: whole or not there, capped, and nobody else's files touched."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from covinz.dead_letters import DeadLetter, DeadLetters, now_text
from tests.uploads import SESSION

LETTER = DeadLetter("a0", SESSION, False, 0, 0, "camera", "too_large", "of 1 byte", now_text(0))


def letter(seq: int) -> DeadLetter:
    return replace(LETTER, first_seq=seq, last_seq=seq, refused_at=now_text(seq * 10**9))


def test_they_are_kept_as_they_came(tmp_path: Path) -> None:
    letters = DeadLetters(tmp_path / "rejected", 10**9)
    assert letters.letters() == []
    for seq in (10, 2, 1):
        letters.put(letter(seq), b"payload %d" % seq)
    assert letters.letters() == [letter(1), letter(2), letter(10)]
    assert letters.payload(letter(10)) == b"payload 10"
    letters.put(letter(2), b"again")  # a crash came between this and the end of the upload
    assert letters.payload(letter(2)) == b"again"
    letters.remove(letter(2))
    letters.remove(letter(2))
    assert letters.letters() == [letter(1), letter(10)]


def test_the_oldest_make_way(tmp_path: Path) -> None:
    letters = DeadLetters(tmp_path, 5 * 8192)
    for seq in range(20):
        letters.put(letter(seq), b"x" * 3000)
    assert letters.letters() == [letter(seq) for seq in range(15, 20)]
    assert len(list(tmp_path.iterdir())) == 10
    letters.put(letter(20), b"x" * 10**6)
    assert letters.letters() == [letter(20)]


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    others = {"notes.txt": b"mine", "list.json": b"[]", "torn.keyframe.json": b'{"agent": "a'}
    for name, content in others.items():
        (tmp_path / name).write_bytes(content)
    letters = DeadLetters(tmp_path, 1)
    letters.put(letter(0), b"one")
    letters.put(letter(1), b"two")
    assert letters.letters() == [letter(1)]
    for name, content in others.items():
        assert (tmp_path / name).read_bytes() == content


def test_a_letter_without_its_message_is_no_letter_to_trip_over(tmp_path: Path) -> None:
    letters = DeadLetters(tmp_path, 1)
    letters.put(letter(0), b"one")
    (tmp_path / letter(0).name).unlink()
    letters.put(letter(1), b"two")
    assert letters.letters() == [letter(1)]


def test_times_as_text() -> None:
    assert now_text(1_800_000_000_123_456_789) == "2027-01-15T08:00:00.123456+00:00"
