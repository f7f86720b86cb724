"""The generated field tables of `covinz.wire.layout`, prepared for the reader and the writer."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from covinz.wire import layout as generated

ENUMS: Final[dict[str, dict[int, str]]] = generated.ENUMS
UNIONS: Final[dict[str, dict[int, str]]] = generated.UNIONS
IDENTIFIERS: Final[dict[str, bytes]] = {k: v.encode() for k, v in generated.MESSAGES.items()}
MESSAGES: Final[dict[bytes, str]] = {v: k for k, v in IDENTIFIERS.items()}


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a table.

    Attributes:
        name: Name in the schema.
        id: Slot in the table's vtable; a union's type is in the slot before.
        kind: scalar, enum, struct, string, table, union, vector (of scalars) or tables.
        type: Name of the enum, struct, table or union.
        required: Absence makes the message malformed.
        default: Value of an absent scalar; None where absence means unknown.
        inline: What stands in the table itself: the value, or an offset to it.
        dtype: Element of a vector.
    """

    name: str
    id: int
    kind: str
    type: str
    required: bool
    default: Any
    inline: struct.Struct
    dtype: np.dtype[Any]


@dataclass(frozen=True, slots=True)
class Table:
    """A table: its fields by id, and in the order they are written (largest first)."""

    name: str
    fields: tuple[Field, ...]
    written: tuple[Field, ...]
    num_slots: int


def _field(row: tuple[str, int, str, str, bool, Any]) -> Field:
    name, number, kind, what, required, default = row
    inline, dtype = struct.Struct("<I"), np.dtype("u1")
    if kind == "scalar":
        inline = struct.Struct("<" + what)
    elif kind == "enum":
        inline = struct.Struct("<B")
        default = None if default is None else ENUMS[what][default]
    elif kind == "struct":
        inline = struct.Struct(f"<{generated.STRUCTS[what]}d")
    elif kind == "vector":
        dtype = np.dtype("?" if what == "?" else "<" + what)
    return Field(name, number, kind, what, required, default, inline, dtype)


def _table(name: str, rows: list[tuple[str, int, str, str, bool, Any]]) -> Table:
    fields = tuple(_field(row) for row in rows)
    written = tuple(sorted(fields, key=lambda field: (-field.inline.size, field.id)))
    return Table(name, fields, written, max((field.id + 1 for field in fields), default=0))


TABLES: Final[dict[str, Table]] = {
    name: _table(name, rows) for name, rows in generated.TABLES.items()
}
