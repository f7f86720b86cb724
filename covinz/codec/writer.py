"""Writes a dictionary of fields as a FlatBuffers message; the inverse of `covinz.codec.reader`.

The same fields always give the same bytes: children are written in the order of field ids, then
the table with its largest fields first.
"""

from __future__ import annotations

import struct
from typing import Any

import flatbuffers
import numpy as np

from covinz.codec.layout import ENUMS, IDENTIFIERS, TABLES, UNIONS, Field, Table
from covinz.codec.reader import Fields


def write(name: str, fields: Fields) -> bytes:
    """Write the message `name`; field values as `covinz.codec.reader.read` returns them.

    Raises:
        ValueError: If a number does not fit its field or a required field is None.
    """
    builder = flatbuffers.Builder(1024 + _bulk(fields))
    try:
        root = write_table(builder, TABLES[name], fields)
    except (struct.error, OverflowError, TypeError) as error:
        raise ValueError(f"{name}: {error}") from error
    builder.Finish(root, IDENTIFIERS[name])
    return bytes(builder.Output())


def _bulk(fields: Fields) -> int:
    """About how many bytes the vectors take, so that the builder rarely grows."""
    total = 0
    for value in fields.values():
        if isinstance(value, np.ndarray):
            total += value.nbytes
        elif isinstance(value, bytes):
            total += len(value)
        elif isinstance(value, dict):
            total += _bulk(value)
        elif isinstance(value, list):
            total += sum(_bulk(item) for item in value if isinstance(item, dict))
    return total


def write_table(builder: Any, table: Table, fields: Fields) -> int:
    """Write a table and all below it; returns its offset in the builder."""
    values = {}
    for field in table.fields:
        value = fields.get(field.name)
        if value is None and field.required:
            raise ValueError(f"{table.name}.{field.name} is missing")
        left_out = value is None or (field.kind in ("scalar", "enum") and value == field.default)
        values[field.id] = None if left_out else _child(builder, field, value)
    builder.StartObject(table.num_slots)
    for field in table.written:
        value = values[field.id]
        if value is None:
            continue
        if field.kind == "union":
            value, number = value
            _inline(builder, struct.Struct("<B"), number, field.id - 1)
        if field.kind in ("scalar", "enum", "struct"):
            _inline(builder, field.inline, value, field.id)
        else:
            builder.PrependUOffsetTRelative(value)
            builder.Slot(field.id)
    offset: int = builder.EndObject()
    return offset


def _inline(builder: Any, form: struct.Struct, value: Any, slot: int) -> None:
    """Put a number, or the tuple of numbers of a struct, into the table."""
    data = form.pack(*value) if isinstance(value, tuple) else form.pack(value)
    builder.Prep(min(form.size, 8), form.size)
    builder.head -= form.size
    builder.Bytes[builder.head : builder.head + form.size] = data
    builder.Slot(slot)


def _child(builder: Any, field: Field, value: Any) -> Any:
    """What the table holds for `value`: itself, or the offset of what is written here."""
    if field.kind == "string":
        return builder.CreateString(value)
    if field.kind == "vector":
        return _vector(builder, field, value)
    if field.kind == "table":
        return write_table(builder, TABLES[field.type], value)
    if field.kind == "tables":
        return _tables(builder, field, value)
    if field.kind == "union":
        name, fields = value
        return write_table(builder, TABLES[name], fields), _number(UNIONS[field.type], name)
    return _number(ENUMS[field.type], value) if field.kind == "enum" else value


def _number(names: dict[int, str], wanted: str) -> int:
    return next(number for number, name in names.items() if name == wanted)


def _vector(builder: Any, field: Field, value: Any) -> Any:
    if isinstance(value, bytes):
        return builder.CreateByteVector(value)
    if field.dtype.itemsize == 1:
        return builder.CreateByteVector(value.astype(field.dtype, casting="equiv").tobytes())
    return builder.CreateNumpyVector(np.ravel(value).astype(field.dtype, casting="same_kind"))


def _tables(builder: Any, field: Field, value: list[Fields]) -> Any:
    offsets = [write_table(builder, TABLES[field.type], item) for item in value]
    builder.StartVector(4, len(offsets), 4)
    for offset in reversed(offsets):
        builder.PrependUOffsetTRelative(offset)
    return builder.EndVector()
