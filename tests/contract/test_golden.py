"""Bytes of every message as first released: they decode to the same values for ever.

flatc, which shares no code with `covinz.codec`, must see the same fields in them.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from covinz import codec
from covinz.codec.reader import message_name, read
from covinz.wire import layout
from tests.contract.examples import EXAMPLES, kind_of, same

ROOT = Path(__file__).parents[2]
GOLDEN = Path(__file__).parent / "golden"
FLATC = Path(sys.executable).parent / "flatc"
EVERY = pytest.mark.parametrize("name", EXAMPLES)


def golden(name: str) -> bytes:
    return (GOLDEN / f"{name}.bin").read_bytes()


def decode(payload: bytes, like: Any) -> Any:
    kind = kind_of(like)
    return codec.decode_upload_reply(payload) if kind is None else codec.decode(payload, kind)


def flatc(*arguments: str | Path) -> None:
    subprocess.run([FLATC, "--strict-json", *arguments], check=True, capture_output=True)


def schema(name: str) -> Path:
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.split("-")[0]).lower()
    return ROOT / "schemas" / f"{words}.fbs"


def as_json(value: Any) -> Any:
    """Fields as flatc prints them."""
    if isinstance(value, tuple):
        x, y, z, qx, qy, qz, qw = value
        rotation = {"x": qx, "y": qy, "z": qz, "w": qw}
        return {"translation": {"x": x, "y": y, "z": z}, "rotation": rotation}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [as_json(item) for item in value]
    if not isinstance(value, dict):
        return value
    fields: dict[str, Any] = {}
    for name, field in value.items():
        if isinstance(field, tuple) and isinstance(field[0], str):
            fields[f"{name}_type"], field = field
        if field is not None:
            fields[name] = as_json(field)
    return fields


def close(a: Any, b: Any) -> bool:
    """Equal but for flatc's 12 digits."""
    if isinstance(a, dict):
        # flatc prints absent scalars as null and an absent union as NONE.
        there = {key: value for key, value in b.items() if value not in (None, "NONE")}
        return a.keys() == there.keys() and all(close(a[key], there[key]) for key in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(close, a, b))
    return math.isclose(a, b, rel_tol=1e-11) if isinstance(a, float) else bool(a == b)


def test_there_is_an_example_of_every_message() -> None:
    assert {name.split("-")[0] for name in EXAMPLES} == set(layout.MESSAGES)
    assert {path.stem for path in GOLDEN.glob("*.bin")} >= set(EXAMPLES)


@EVERY
def test_golden_bytes_decode_to_the_known_value(name: str) -> None:
    # T_odom_body and the like were chosen so that their quaternions are exact.
    assert same(decode(golden(name), EXAMPLES[name]), EXAMPLES[name])


@EVERY
def test_known_value_encodes_to_the_golden_bytes(name: str) -> None:
    assert codec.encode(EXAMPLES[name]) == golden(name)


@EVERY
def test_schema_name(name: str) -> None:
    assert codec.schema_name(golden(name)) == f"covinz.{name.split('-')[0]}/1"


@EVERY
def test_flatc_sees_the_same_fields(name: str, tmp_path: Path) -> None:
    payload = golden(name)
    flatc("--json", "--defaults-json", "-o", tmp_path, schema(name), "--", GOLDEN / f"{name}.bin")
    seen = json.loads((tmp_path / f"{name}.json").read_text())
    fields = as_json(read(payload, message_name(payload)))
    assert close(fields, seen)


@EVERY
def test_what_flatc_writes_is_read(name: str, tmp_path: Path) -> None:
    flatc("--json", "-o", tmp_path, schema(name), "--", GOLDEN / f"{name}.bin")
    flatc("--binary", "-o", tmp_path, schema(name), tmp_path / f"{name}.json")
    payload = (tmp_path / f"{name}.bin").read_bytes()
    again = codec.encode(decode(payload, EXAMPLES[name]))
    ours = read(golden(name), message_name(golden(name)))
    assert close(as_json(read(again, message_name(again))), as_json(ours))
