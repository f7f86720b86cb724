"""Where the parts of a good message stand: offsets, vtables, lengths, numbers, texts.

It walks a message by the generated tables as a trusting reader does, and shares no code with the
reader that is tested; so it is for messages that are known to be good.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from covinz.codec.layout import MESSAGES, TABLES, UNIONS, Field, Table

# So many elements at each end of a vector are parts of a message.
MAX_ELEMENTS = 64


class Role(enum.Enum):
    """What stands at a place."""

    OFFSET = enum.auto()  # uint32, relative, forward
    VTABLE = enum.auto()  # int32 of a table, or a uint16 in its vtable
    LENGTH = enum.auto()  # uint32 before the elements of a vector or the bytes of a string
    NUMBER = enum.auto()  # a scalar or an element of a vector
    FLOAT = enum.auto()  # the same as float64
    TEXT = enum.auto()  # a byte of a string


@dataclass(frozen=True, slots=True)
class Site:
    """A part of a message.

    Attributes:
        at: Its first byte.
        size: Its bytes.
        role: What it is.
    """

    at: int
    size: int
    role: Role


@dataclass(frozen=True, slots=True)
class Anatomy:
    """The parts of a message, those of messages inside it too.

    Attributes:
        every: In the order in which they stand.
        of: The same by what they are.
    """

    every: tuple[Site, ...]
    of: Mapping[Role, tuple[Site, ...]]


def dissect(payload: bytes) -> Anatomy:
    """The anatomy of a good message."""
    found = {site.at: site for site in _message(payload, 0)}
    every = tuple(found[at] for at in sorted(found))
    return Anatomy(every, {role: tuple(s for s in every if s.role is role) for role in Role})


def _message(data: bytes, start: int) -> Iterator[Site]:
    table = TABLES[MESSAGES[data[start + 4 : start + 8]]]
    yield Site(start, 4, Role.OFFSET)
    yield from _table(data, start + _u32(data, start), table)


def _table(data: bytes, at: int, table: Table) -> Iterator[Site]:
    vtable = at - struct.unpack_from("<i", data, at)[0]
    yield Site(at, 4, Role.VTABLE)
    slots = struct.unpack_from("<H", data, vtable)[0] // 2
    for slot in range(slots):
        yield Site(vtable + 2 * slot, 2, Role.VTABLE)
    fields = [(field, field.id) for field in table.fields]
    for field, slot in fields:
        place = _slot(data, vtable, slots, slot)
        if place:
            yield from _field(data, at + place, field, at + _slot(data, vtable, slots, slot - 1))
    if table.name == "LogPage":
        yield from _entries(data, at, vtable, slots, dict((f.name, n) for f, n in fields))


def _slot(data: bytes, vtable: int, slots: int, slot: int) -> int:
    if not 0 <= slot < slots - 2:
        return 0
    place: int = struct.unpack_from("<H", data, vtable + 4 + 2 * slot)[0]
    return place


def _field(data: bytes, at: int, field: Field, type_at: int) -> Iterator[Site]:
    if field.kind in ("scalar", "enum"):
        yield Site(at, field.inline.size, Role.FLOAT if field.type == "d" else Role.NUMBER)
        return
    if field.kind == "struct":
        yield from (Site(at + i, 8, Role.FLOAT) for i in range(0, field.inline.size, 8))
        return
    yield Site(at, 4, Role.OFFSET)
    target = at + _u32(data, at)
    if field.kind == "table":
        yield from _table(data, target, TABLES[field.type])
    elif field.kind == "union":
        yield Site(type_at, 1, Role.NUMBER)
        yield from _table(data, target, TABLES[UNIONS[field.type][data[type_at]]])
    else:
        yield from _vector(data, target, field)


def _vector(data: bytes, at: int, field: Field) -> Iterator[Site]:
    yield Site(at, 4, Role.LENGTH)
    length, first = _u32(data, at), at + 4
    if field.kind == "tables":
        for place in range(first, first + 4 * length, 4):
            yield Site(place, 4, Role.OFFSET)
            yield from _table(data, place + _u32(data, place), TABLES[field.type])
    elif field.kind == "string":
        yield from (Site(first + i, 1, Role.TEXT) for i in range(length + 1))
    else:
        size = field.dtype.itemsize
        role = Role.FLOAT if field.dtype.kind == "f" else Role.NUMBER
        # A thousand descriptors are as good as a few.
        chosen = (i for i in range(length) if min(i, length - 1 - i) < MAX_ELEMENTS)
        yield from (Site(first + size * i, size, role) for i in chosen)


def _entries(
    data: bytes, at: int, vtable: int, slots: int, numbers: dict[str, int]
) -> Iterator[Site]:
    """The messages that a page of the log carries."""
    ends, messages = (
        at + place + _u32(data, at + place)
        for place in (_slot(data, vtable, slots, numbers[name]) for name in ("ends", "messages"))
    )
    start = 0
    for i in range(_u32(data, ends)):
        yield from _message(data, messages + 4 + start)
        start = _u32(data, ends + 4 + 4 * i)


def _u32(data: bytes, at: int) -> int:
    number: int = struct.unpack_from("<I", data, at)[0]
    return number
