"""What makes two logs the same: a hash over all entries, kept for every index.

A file that was replaced by an older copy of itself grows on with other keyframes under the same
indices; who has followed the one can tell the other by its chain.
"""

from __future__ import annotations

import hashlib
import sqlite3

DIGEST_SIZE = 16
# Of a log without entries.
NO_CHAIN = bytes(DIGEST_SIZE)


def digest_of(payload: bytes) -> bytes:
    """Hash of a message as it was uploaded."""
    return hashlib.blake2b(payload, digest_size=DIGEST_SIZE).digest()


def chained(chain: bytes, digest: bytes) -> bytes:
    """The chain with one entry more."""
    return hashlib.blake2b(chain + digest, digest_size=DIGEST_SIZE).digest()


def chain_at(db: sqlite3.Connection, index: int) -> bytes | None:
    """The chain over the first `index` entries of a log; None beyond its head."""
    if index == 0:
        return NO_CHAIN
    row = db.execute("SELECT value FROM chain WHERE log_index = ?", (index - 1,)).fetchone()
    return None if row is None else bytes(row[0])
