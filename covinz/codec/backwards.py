"""The bytes of a FlatBuffers message, written from its end to its beginning.

Offsets of FlatBuffers point forward, so what they point at is written before them. A place is the
number of bytes from there to the message's end, and stays what it is while the message grows.
Everything is aligned as seen from the end; `finish` makes the length a multiple of all alignments.
The bytes are those of the FlatBuffers runtime, which writes every number by itself; here a table
is packed at once.

Source: https://flatbuffers.dev/internals (format).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from covinz.codec.layout import Field, Table

_U32: Final = struct.Struct("<I")
# No number is larger, so a table's padding depends on its place modulo this.
_MAX_ALIGNMENT: Final = 8


@dataclass(frozen=True, slots=True)
class _Shape:
    """A table with certain fields, that ends at a certain place modulo `_MAX_ALIGNMENT`.

    Attributes:
        form: The whole table, its offset to the vtable first.
        fields: In the order of `form`; True for the type of a union, which precedes it in `Table`.
        places: Of the fields, from the table's end.
        vtable: Its bytes.
        alignment: Of the field that needs most.
    """

    form: struct.Struct
    fields: tuple[tuple[Field, bool], ...]
    places: tuple[int, ...]
    vtable: bytes
    alignment: int


class BackwardsBuffer:
    """A message that grows to the front."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0
        self._alignment = 4
        self._vtables: dict[bytes, int] = {}

    def string(self, value: str) -> int:
        """Write a string; returns its place."""
        data = value.encode()
        return self._counted(data + b"\0", len(data), 1)

    def vector(self, data: bytes, item_size: int) -> int:
        """Write a vector of numbers, which are encoded already; returns its place."""
        return self._counted(data, len(data) // item_size, item_size)

    def references(self, targets: Sequence[int]) -> int:
        """Write a vector of offsets to places; returns its own place."""
        # Their padding comes first, at the end.
        last = self._size + (-self._size % 4)
        steps = range(4 * len(targets), 0, -4)
        offsets = [last + step - target for step, target in zip(steps, targets, strict=True)]
        return self._counted(struct.pack(f"<{len(offsets)}I", *offsets), len(offsets), 4)

    def table(self, table: Table, values: dict[int, Any]) -> int:
        """Write a table; returns its place.

        Args:
            table: Says what its fields are.
            values: Of those that are there, by field id: a number, numbers of a struct, the place
                of anything else, or (place, number of the type) of a union.

        Raises:
            struct.error: If a number does not fit.
        """
        shape = _shape(table, values, self._size % _MAX_ALIGNMENT)
        numbers: list[Any] = []
        for (field, is_type), place in zip(shape.fields, shape.places, strict=True):
            value = values[field.id]
            if field.kind == "struct":
                numbers.extend(value)
            elif field.kind in ("scalar", "enum"):
                numbers.append(value)
            elif is_type:
                numbers.append(value[1])
            else:
                target = value[0] if field.kind == "union" else value
                numbers.append(self._size + place - target)
        end = self._size + shape.form.size
        known = self._vtables.get(shape.vtable)
        vtable = end + len(shape.vtable) if known is None else known
        self._put(shape.form.pack(vtable - end, *numbers))
        if known is None:
            self._put(shape.vtable)
            self._vtables[shape.vtable] = vtable
        self._alignment = max(self._alignment, shape.alignment)
        return end

    def finish(self, root: int, identifier: bytes) -> bytes:
        """The message whose root is the table at a place."""
        padding = bytes(-(self._size + 8) % self._alignment)
        size = self._size + len(padding) + 8
        return b"".join([_U32.pack(size - root), identifier, padding, *reversed(self._parts)])

    def _counted(self, data: bytes, count: int, alignment: int) -> int:
        """Write a number of elements before the elements."""
        alignment = max(4, alignment)
        padding = -(self._size + len(data)) % alignment
        self._put(_U32.pack(count) + data + bytes(padding))
        self._alignment = max(self._alignment, alignment)
        return self._size

    def _put(self, data: bytes) -> None:
        self._parts.append(data)
        self._size += len(data)


# By a table's name, the ids of the fields that are there, and where it ends.
_shapes: dict[tuple[str, tuple[int, ...], int], _Shape] = {}


def _shape(table: Table, values: dict[int, Any], end: int) -> _Shape:
    key = (table.name, tuple(values), end)
    shape = _shapes.get(key)
    if shape is None:
        shape = _shapes[key] = _new_shape(table, values, end)
    return shape


def _new_shape(table: Table, values: dict[int, Any], end: int) -> _Shape:
    at, alignment = end, 4
    codes, fields, places = [""], [], []
    slots = [0] * table.num_slots
    for field, is_type in _written(table, values):
        size = 1 if is_type else field.inline.size
        padding = -(at + size) % min(size, _MAX_ALIGNMENT)
        at += padding + size
        alignment = max(alignment, min(size, _MAX_ALIGNMENT))
        codes.append(f"{'B' if is_type else field.inline.format[1:]}{padding}x")
        fields.append((field, is_type))
        places.append(at - end)
        slots[field.id - is_type] = at
    codes[0] = f"<i{-at % 4}x"
    at += -at % 4 + 4
    while slots and not slots[-1]:
        slots.pop()
    entries = [at - slot if slot else 0 for slot in slots]
    vtable = struct.pack(f"<{2 + len(entries)}H", 4 + 2 * len(entries), at - end, *entries)
    form = struct.Struct("".join([codes[0], *reversed(codes[1:])]))
    return _Shape(form, tuple(reversed(fields)), tuple(reversed(places)), vtable, alignment)


def _written(table: Table, values: dict[int, Any]) -> list[tuple[Field, bool]]:
    """The fields that are there in the order they are written, types of unions before them."""
    written: list[tuple[Field, bool]] = []
    for field in table.written:
        if field.id in values:
            written += [(field, True)] if field.kind == "union" else []
            written.append((field, False))
    return written
