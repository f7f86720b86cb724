"""What a log keeps when it grows old or large: features go, oldest first; poses stay."""

from __future__ import annotations

import sqlite3

from covinz.durable import DurableFile

# The value of `PRAGMA auto_vacuum` of files that can be made smaller.
_INCREMENTAL = 2

_BETWEEN = "WHERE log_index >= ? AND log_index < ?"
_ALL_BUT_PAYLOAD = "log_index, agent, session, is_gap, first_seq, last_seq, digest, pose"


class Retained:
    """The features in a log's file and the room that they take; for the log's thread.

    Methods that write may raise sqlite3.Error; then nothing was changed.
    """

    def __init__(self, file: DurableFile) -> None:
        self._file = file
        row = file.db.execute("SELECT features_from, running_s FROM retention").fetchone()
        self.features_from, self.running_s = int(row[0]), float(row[1])
        self._can_shrink = self._pragma("auto_vacuum") == _INCREMENTAL

    @property
    def used_bytes(self) -> int:
        """What the log takes, without room that was freed and waits to be used or given back."""
        return (self._pragma("page_count") - self.free_pages) * self._pragma("page_size")

    @property
    def free_pages(self) -> int:
        """Pages of the file that hold nothing."""
        return self._pragma("freelist_count")

    @property
    def pages_to_give_back(self) -> int:
        """Free pages by which the file can be made smaller: none of a file of format 1."""
        return self.free_pages if self._can_shrink else 0

    def drop_features(self, until: int) -> None:
        """Keep only the poses of all entries before index `until`."""
        # Not waiting for the disk: undone by a power cut it is done again.
        with self._file.transaction(durable=False) as db:
            # Taken out and put in again: rows that only shrink would keep a page each.
            rows = db.execute(
                f"SELECT {_ALL_BUT_PAYLOAD}, CASE WHEN is_gap THEN payload ELSE x'' END FROM entry"
                f" {_BETWEEN} ORDER BY log_index",
                (self.features_from, until),
            ).fetchall()
            db.execute(f"DELETE FROM entry {_BETWEEN}", (self.features_from, until))
            marks = ", ".join("?" * len(rows[0])) if rows else ""
            db.executemany(f"INSERT INTO entry VALUES ({marks})", rows)
            db.execute("UPDATE retention SET features_from = ?", (until,))
        self.features_from = until

    def give_back(self, pages: int) -> None:
        """Make the file smaller by up to so many free pages."""
        # As a script: `execute` would stop after the first page.
        self._file.db.executescript(f"PRAGMA incremental_vacuum({pages})")

    def note_age(self, head: int, ran_s: float) -> None:
        """Ingest has run for `ran_s` more, and the log has `head` entries now."""
        running_s = self.running_s + ran_s
        with self._file.transaction(durable=False) as db:
            db.execute("UPDATE retention SET running_s = ?", (running_s,))
            db.execute("INSERT OR IGNORE INTO age VALUES (?, ?)", (head, running_s))
        self.running_s = running_s

    def older_than(self, age_s: float) -> int:
        """Number of entries that ingest has run for longer than `age_s` with."""
        row = self._file.db.execute(
            "SELECT MAX(head) FROM age WHERE running_s <= ?", (self.running_s - age_s,)
        ).fetchone()
        return int(row[0] or 0)

    def forget_ages(self) -> None:
        """Ages of entries without features are of no use."""
        with self._file.transaction(durable=False) as db:
            db.execute("DELETE FROM age WHERE head < ?", (self.features_from,))

    def _pragma(self, name: str) -> int:
        (value,) = self._file.db.execute(f"PRAGMA {name}").fetchone()
        return int(value)


def features_from(db: sqlite3.Connection) -> int:
    """Index of the first entry of a log that still has its features."""
    return int(db.execute("SELECT features_from FROM retention").fetchone()[0])
