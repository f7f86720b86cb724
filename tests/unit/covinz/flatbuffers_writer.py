"""Writes fields as `covinz.codec.writer` must, by the FlatBuffers runtime: number by number."""

from __future__ import annotations

import struct
from typing import Any

import flatbuffers
import numpy as np

from covinz.codec.layout import ENUMS, IDENTIFIERS, TABLES, UNIONS, Field, Table
from covinz.codec.reader import Fields


def write(name: str, fields: Fields) -> bytes:
    """The message `name`."""
    builder = flatbuffers.Builder()
    root = write_table(builder, TABLES[name], fields)
    builder.Finish(root, IDENTIFIERS[name])
    return bytes(builder.Output())


def write_table(builder: Any, table: Table, fields: Fields) -> int:
    """Write a table and all below it; returns its offset in the builder."""
    values = {}
    for field in table.fields:
        value = fields.get(field.name)
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
