"""Writes a dictionary of fields as a FlatBuffers message; the inverse of `covinz.codec.reader`.

The same fields always give the same bytes: children are written in the order of field ids, then
the table with its largest fields first.
"""

from __future__ import annotations

import struct
from typing import Any, Final

import numpy as np

from covinz.codec.backwards import BackwardsBuffer
from covinz.codec.layout import ENUMS, IDENTIFIERS, TABLES, UNIONS, Field, Table
from covinz.codec.reader import Fields

_NUMBERS: Final = {
    kind: {name: number for number, name in names.items()}
    for kind, names in (ENUMS | UNIONS).items()
}


def write(name: str, fields: Fields) -> bytes:
    """Write the message `name`; field values as `covinz.codec.reader.read` returns them.

    Raises:
        ValueError: If a number does not fit its field or a required field is None.
    """
    buffer = BackwardsBuffer()
    try:
        root = _table(buffer, TABLES[name], fields)
        return buffer.finish(root, IDENTIFIERS[name])
    except (struct.error, OverflowError, TypeError) as error:
        raise ValueError(f"{name}: {error}") from error


def _table(buffer: BackwardsBuffer, table: Table, fields: Fields) -> int:
    """Write a table and all below it; returns its place."""
    values = {}
    for field in table.fields:
        value = fields.get(field.name)
        if value is None:
            if field.required:
                raise ValueError(f"{table.name}.{field.name} is missing")
        elif field.kind == "struct":
            values[field.id] = value
        elif field.kind not in ("scalar", "enum"):
            values[field.id] = _child(buffer, field, value)
        elif value != field.default:
            values[field.id] = value if field.kind == "scalar" else _NUMBERS[field.type][value]
    return buffer.table(table, values)


def _child(buffer: BackwardsBuffer, field: Field, value: Any) -> Any:
    """Write what the table refers to; returns its place, and the number of a union's type."""
    if field.kind == "string":
        return buffer.string(value)
    if field.kind == "vector":
        return buffer.vector(_bytes(field, value), field.dtype.itemsize)
    if field.kind == "table":
        return _table(buffer, TABLES[field.type], value)
    if field.kind == "tables":
        table = TABLES[field.type]
        return buffer.references([_table(buffer, table, item) for item in value])
    name, fields = value
    return _table(buffer, TABLES[name], fields), _NUMBERS[field.type][name]


def _bytes(field: Field, value: Any) -> bytes:
    """The numbers of a vector as they travel."""
    if isinstance(value, bytes):
        return value
    array = np.asarray(value)
    if field.dtype.itemsize == 1:
        return array.astype(field.dtype, casting="equiv", copy=False).tobytes()
    return array.astype(field.dtype, casting="same_kind", copy=False).tobytes()
