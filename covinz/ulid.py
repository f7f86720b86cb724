"""ULIDs: 128-bit ids that sort by the time they were made, as 26 characters.

Source: the ULID specification, https://github.com/ulid/spec (Crockford's base 32).
"""

from __future__ import annotations

from covinz.machine import THIS_MACHINE, Machine

_ALPHABET = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"


def ulid(time_ms: int, entropy: bytes) -> str:
    """The ULID of a time since the Unix epoch [ms] and ten random bytes.

    Raises:
        ValueError: If the time does not fit in 48 bits or `entropy` is not ten bytes.
    """
    if not 0 <= time_ms < 1 << 48 or len(entropy) != 10:
        raise ValueError("a ULID is made of 48 bits of milliseconds and ten bytes")
    value = time_ms << 80 | int.from_bytes(entropy, "big")
    return "".join(_ALPHABET[value >> shift & 31] for shift in range(125, -1, -5))


def new_ulid(machine: Machine = THIS_MACHINE) -> str:
    """A ULID of now."""
    return ulid(machine.now_ns() // 1_000_000, machine.random_bytes(10))
