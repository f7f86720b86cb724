"""How a good message is spoilt: each mutation changes bytes where it hurts.

Every mutation is a function of a generator, the message, its parts and another message; the same
generator gives the same bytes.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Mapping
from random import Random
from typing import Final

from covinz.codec.layout import IDENTIFIERS
from tests.fuzz.anatomy import Anatomy, Role, Site

Mutation = Callable[[Random, bytearray, Anatomy, bytes], bytearray]

_WORDS: Final = tuple(
    number.to_bytes(8, "little")
    for number in (
        *(0, 1, 2, 3, 4, 7, 8, 127, 128, 255, 256, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 4),
        *(2**32 - 1, 2**32, 2**53, 2**63 - 1, 2**63, 2**64 - 8, 2**64 - 1),
    )
)
_HUGE, _INF, _NAN = sys.float_info.max, float("inf"), float("nan")
_FLOATS: Final = (
    *(struct.pack("<d", number) for number in (0.0, -0.0, 1.0, -1.0, 1 + 2e-6, 2.0, 1e9, -1.1e9)),
    *(struct.pack("<d", number) for number in (1e18, 1e19, 1e154, 1e155, 1e300, _HUGE, 5e-324)),
    *(struct.pack("<d", number) for number in (1e-200, _INF, -_INF, _NAN)),
    b"\x01\x00\x00\x00\x00\x00\xf0\x7f",  # a signalling NaN
    b"\xff" * 8,
)
_BYTES: Final = b"\x00\x01\x0a\x20#$*/?\x7f\x80\xc0\xe2\xed\xf4\xff"
_IDENTIFIERS: Final = tuple(sorted(IDENTIFIERS.values()))
MAX_BYTES: Final = 1 << 17


def flip_bits(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """A few bits anywhere."""
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16)) if data else 0):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return data


def set_bytes(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """A few bytes anywhere."""
    for _ in range(rng.choice((1, 1, 2, 8)) if data else 0):
        data[rng.randrange(len(data))] = (
            rng.choice(_BYTES) if rng.random() < 0.5 else rng.randrange(256)
        )
    return data


def set_word(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """An aligned integer anywhere becomes one of those where arithmetic goes wrong."""
    size = rng.choice((2, 4, 8))
    if len(data) >= size:
        at = rng.randrange(len(data) // size) * size
        data[at : at + size] = rng.choice(_WORDS)[:size]
    return data


def turn_offset(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """An offset points to something else in the message, close by, backwards or far outside."""
    site = _pick(rng, parts, Role.OFFSET, len(data))
    if site is None:
        return data
    (offset,) = struct.unpack_from("<I", data, site.at)
    how = rng.randrange(4)
    if how == 0:
        offset += rng.choice((-8, -4, -2, -1, 1, 2, 4, 8, 16))
    elif how == 1:
        offset = rng.choice(parts.every).at - site.at
    elif how == 2:
        offset = rng.randrange(0, len(data) + 8, 4) - site.at
    else:
        offset = int.from_bytes(rng.choice(_WORDS)[:4], "little")
    struct.pack_into("<I", data, site.at, offset % 2**32)
    return data


def spoil_vtable(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """A table lies about its vtable, or a vtable about its table."""
    site = _pick(rng, parts, Role.VTABLE, len(data))
    if site is None:
        return data
    form = "<i" if site.size == 4 else "<H"
    (number,) = struct.unpack_from(form, data, site.at)
    if rng.random() < 0.5:
        number += rng.choice((-8, -4, -2, -1, 1, 2, 4, 8))
    elif site.size == 4:
        number = site.at - rng.choice(parts.every).at
    else:
        number = rng.choice((0, 1, 2, 4, 6, 8, 12, 16, 24, 255, 2**15, 2**16 - 1))
    if site.size == 4:
        struct.pack_into("<i", data, site.at, max(-(2**31), min(number, 2**31 - 1)))
    else:
        struct.pack_into("<H", data, site.at, number % 2**16)
    return data


def change_length(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """A vector or text is longer or shorter than it says."""
    site = _pick(rng, parts, Role.LENGTH, len(data))
    if site is None:
        return data
    (length,) = struct.unpack_from("<I", data, site.at)
    how = rng.randrange(3)
    if how == 0:
        length += rng.choice((-32, -8, -2, -1, 1, 2, 7, 8, 21, 32, 36))
    elif how == 1:
        length = (len(data) - site.at - 4) // rng.choice((1, 2, 4, 8)) + rng.choice((-1, 0, 1))
    else:
        length = int.from_bytes(rng.choice(_WORDS)[:4], "little")
    struct.pack_into("<I", data, site.at, length % 2**32)
    return data


def set_number(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """Numbers become not-a-number, infinite, huge, tiny, negative."""
    for _ in range(rng.choice((1, 1, 1, 2, 6))):
        role = Role.FLOAT if rng.random() < 0.6 else Role.NUMBER
        site = _pick(rng, parts, role, len(data))
        if site is not None:
            chosen = rng.choice(_FLOATS if role is Role.FLOAT else _WORDS)
            data[site.at : site.at + site.size] = chosen[: site.size]
    return data


def set_text(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """A byte of a text becomes one that names, keys or UTF-8 do not allow."""
    site = _pick(rng, parts, Role.TEXT, len(data))
    if site is not None:
        data[site.at] = rng.choice(_BYTES)
    return data


def cut(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """The end is missing."""
    return data[: rng.randrange(len(data) + 1)]


def extend(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """Something follows."""
    return data + (rng.randbytes(rng.randrange(64)) if rng.random() < 0.5 else other)


def splice(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """The beginning of one message and the end of another."""
    at = rng.randrange(0, len(data) + 1, 4)
    behind = at if rng.random() < 0.5 else rng.randrange(0, len(other) + 1, 4)
    return data[:at] + other[behind:]


def transplant(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """A block of another message, or of the same one, in the place of this one's."""
    source = other if rng.random() < 0.7 else bytes(data)
    if min(len(source), len(data)) >= 8:
        size = 4 * rng.randrange(1, min(len(source), len(data)) // 4 + 1)
        start = rng.randrange(0, len(source) - size + 1, 4)
        at = rng.randrange(0, len(data) - size + 1, 4)
        data[at : at + size] = source[start : start + size]
    return data


def rename(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """It says that it is another message."""
    data[4:8] = rng.choice(_IDENTIFIERS)
    return data


def noise(rng: Random, data: bytearray, parts: Anatomy, other: bytes) -> bytearray:
    """Random bytes, often behind a good beginning."""
    made = bytearray(rng.randbytes(rng.choice((0, 3, 7, 8, 12, 40, 200, 1000))))
    if rng.random() < 0.7:
        made[4:8] = rng.choice(_IDENTIFIERS)
        made[:4] = rng.choice((4, 8, 12, 16, 32)).to_bytes(4, "little")
    return made


# Each with its weight; those that reach deep are tried more often.
MUTATIONS: Final[Mapping[Mutation, int]] = {
    flip_bits: 3,
    set_bytes: 3,
    set_word: 3,
    turn_offset: 4,
    spoil_vtable: 3,
    change_length: 3,
    set_number: 6,
    set_text: 3,
    cut: 2,
    extend: 1,
    splice: 2,
    transplant: 3,
    rename: 1,
    noise: 1,
}
_KINDS: Final = tuple(mutation for mutation, weight in MUTATIONS.items() for _ in range(weight))


def mutate(
    rng: Random, payload: bytes, parts: Anatomy, other: bytes
) -> tuple[bytes, tuple[Mutation, ...]]:
    """A spoilt message, and what was done to it."""
    data, done = bytearray(payload), []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        done.append(rng.choice(_KINDS))
        data = done[-1](rng, data, parts, other)
    return bytes(data[:MAX_BYTES]), tuple(done)


def _pick(rng: Random, parts: Anatomy, role: Role, size: int) -> Site | None:
    """A part of this role, if it has not been cut off."""
    sites = parts.of[role]
    site = rng.choice(sites) if sites else None
    return site if site is not None and site.at + site.size <= size else None
