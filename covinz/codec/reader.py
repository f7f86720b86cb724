"""A verifying FlatBuffers reader: bytes to a dictionary of fields, or MalformedMessage.

The Python runtime of FlatBuffers trusts its input: it does not verify offsets, lengths or
``(required)``. This reader checks all that the C++ verifier checks, while it reads: every offset
points forward and inside the payload, tables and vectors lie inside it and are aligned, strings are
terminated UTF-8, required fields are there, enum values and union types are known. Since offsets
point forward and no table contains itself, reading ends. Data that many offsets point at would
still make a small payload grow large, so what is read in all is limited to a multiple of it.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covinz.codec.layout import ENUMS, IDENTIFIERS, MESSAGES, TABLES, UNIONS, Field, Table

Fields = dict[str, Any]

_U8 = struct.Struct("<B")
_U16_PAIR = struct.Struct("<HH")
_U32 = struct.Struct("<I")
_I32 = struct.Struct("<i")
_SLOTS = [struct.Struct(f"<{n}H") for n in range(1 + max(t.num_slots for t in TABLES.values()))]

# A message may share strings and tables (FlatBuffers allows it), up to this growth.
MAX_GROWTH = 8


class MalformedMessage(ValueError):
    """Bytes that are not the message they should be; the text says where."""


def message_name(payload: bytes) -> str:
    """Root table of a payload, by its file identifier; MalformedMessage when there is none."""
    name = MESSAGES.get(payload[4:8])
    if name is None:
        raise MalformedMessage(f"no covinz message has the identifier {payload[4:8]!r}")
    return name


def read(payload: bytes, name: str) -> Fields:
    """Read the message `name`.

    Returns:
        Field name to value: int, float, bool, str; name of an enum value; tuple of numbers of a
        struct; Fields of a table; list of Fields; read-only array of a vector of scalars, which
        refers to the payload; (table name, Fields) of a union; None when absent.

    Raises:
        MalformedMessage: If the payload is not such a message.
    """
    if payload[4:8] != IDENTIFIERS[name]:
        raise MalformedMessage(f"expected a {name}, got the identifier {payload[4:8]!r}")
    return read_table(payload, TABLES[name])


def read_table(payload: bytes, table: Table) -> Fields:
    """Read a payload whose root is `table`, whatever its identifier; otherwise as `read`."""
    if len(payload) < 8:
        raise MalformedMessage("shorter than any message")
    return _Reader(payload).root(table)


class _Reader:
    def __init__(self, payload: bytes) -> None:
        self._data = payload
        self._size = len(payload)
        self._budget = MAX_GROWTH * len(payload)

    def root(self, table: Table) -> Fields:
        return self._table(self._target(0), table)

    def _target(self, at: int) -> int:
        """Where the offset at `at` points to; room for one more uint32 is there."""
        offset: int = _U32.unpack_from(self._data, at)[0]
        end = at + offset
        if offset < 4 or end % 4 or end + 4 > self._size:
            raise MalformedMessage(f"byte {at}: offset {offset} points nowhere")
        return end

    def _spend(self, num_bytes: int) -> None:
        self._budget -= num_bytes
        if self._budget < 0:
            raise MalformedMessage(f"reads as more than {MAX_GROWTH} times its size")

    def _slots(self, at: int, table: Table) -> tuple[tuple[int, ...], int]:
        """The vtable's entries for the known fields and the table's own length."""
        vtable = at - _I32.unpack_from(self._data, at)[0]
        if not 0 <= vtable <= self._size - 4 or vtable % 2:
            raise MalformedMessage(f"byte {at}: {table.name} has no vtable")
        vtable_size, table_size = _U16_PAIR.unpack_from(self._data, vtable)
        if vtable_size < 4 or vtable_size % 2 or vtable + vtable_size > self._size:
            raise MalformedMessage(f"byte {vtable}: vtable of {table.name} outside the payload")
        if table_size < 4 or at + table_size > self._size:
            raise MalformedMessage(f"byte {at}: {table.name} outside the payload")
        known = _SLOTS[min((vtable_size - 4) // 2, table.num_slots)]
        self._spend(table_size)
        return known.unpack_from(self._data, vtable + 4), table_size

    def _table(self, at: int, table: Table) -> Fields:
        slots, table_size = self._slots(at, table)
        fields: Fields = {}
        for field in table.fields:
            offset = slots[field.id] if field.id < len(slots) else 0
            if offset == 0:
                if field.required:
                    raise MalformedMessage(f"{table.name}.{field.name} is missing")
                fields[field.name] = field.default
                continue
            size = field.inline.size
            where = at + offset
            if offset < 4 or offset + size > table_size or where % min(size, 8):
                raise MalformedMessage(f"{table.name}.{field.name} outside its table")
            if field.kind == "union":
                type_slot = slots[field.id - 1]
                if not 4 <= type_slot < table_size:
                    raise MalformedMessage(f"{table.name}.{field.name} is of no type")
                fields[field.name] = self._union(where, at + type_slot, field)
            else:
                fields[field.name] = self._value(where, field)
        return fields

    def _value(self, at: int, field: Field) -> Any:
        kind = field.kind
        if kind == "scalar":
            return field.inline.unpack_from(self._data, at)[0]
        if kind == "string":
            return self._string(self._target(at), field)
        if kind == "struct":
            return field.inline.unpack_from(self._data, at)
        if kind == "vector":
            return self._vector(self._target(at), field)
        if kind == "table":
            return self._table(self._target(at), TABLES[field.type])
        if kind == "tables":
            return self._tables(self._target(at), field)
        name = ENUMS[field.type].get(field.inline.unpack_from(self._data, at)[0])
        if name is None:
            raise MalformedMessage(f"{field.name}: unknown {field.type}")
        return name

    def _union(self, at: int, type_at: int, field: Field) -> tuple[str, Fields]:
        name = UNIONS[field.type].get(_U8.unpack_from(self._data, type_at)[0])
        if name is None:
            raise MalformedMessage(f"{field.name}: unknown {field.type}")
        return name, self._table(self._target(at), TABLES[name])

    def _length(self, at: int, element_size: int, field: Field) -> int:
        """Number of elements of the vector at `at`, all of which lie inside the payload."""
        length: int = _U32.unpack_from(self._data, at)[0]
        if length * element_size > self._size - at - 4:
            raise MalformedMessage(f"{field.name}: {length} elements do not fit in the payload")
        self._spend(4 + length * element_size)
        return length

    def _string(self, at: int, field: Field) -> str:
        end = at + 4 + self._length(at, 1, field)
        if end >= self._size or self._data[end] != 0:
            raise MalformedMessage(f"{field.name}: string without an end")
        try:
            return self._data[at + 4 : end].decode()
        except UnicodeDecodeError as error:
            raise MalformedMessage(f"{field.name}: {error}") from error

    def _vector(self, at: int, field: Field) -> NDArray[Any]:
        length = self._length(at, field.dtype.itemsize, field)
        if length and (at + 4) % field.dtype.itemsize:
            raise MalformedMessage(f"{field.name}: vector is not aligned")
        if field.dtype == np.bool_:
            # Other bytes than 0 and 1 would make strange booleans.
            return np.frombuffer(self._data, np.uint8, length, at + 4).astype(np.bool_)
        return np.frombuffer(self._data, field.dtype, length, at + 4)

    def _tables(self, at: int, field: Field) -> list[Fields]:
        length = self._length(at, 4, field)
        table = TABLES[field.type]
        return [self._table(self._target(at + 4 + 4 * i), table) for i in range(length)]
