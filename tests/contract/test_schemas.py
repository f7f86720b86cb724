"""The schemas themselves: generated code is current, fields are explained, nothing is ambiguous."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from covinz.wire import layout

ROOT = Path(__file__).parents[2]
SCHEMAS = sorted((ROOT / "schemas").glob("*.fbs"))
FIELD = re.compile(r"^\s+(\w+):.*\bid: \d+\);$")


def generate_check(root: Path) -> int:
    script = root / "schemas" / "generate.py"
    command = [sys.executable, str(script), "--check"]
    return subprocess.run(command, stderr=subprocess.DEVNULL, check=False).returncode


def test_generated_layout_is_what_the_schemas_say() -> None:
    assert generate_check(ROOT) == 0


@pytest.mark.parametrize("change", ["schema", "layout"])
def test_drift_is_noticed(tmp_path: Path, change: str) -> None:
    shutil.copytree(ROOT / "schemas", tmp_path / "schemas")
    shutil.copytree(ROOT / "covinz" / "wire", tmp_path / "covinz" / "wire")
    assert generate_check(tmp_path) == 0
    if change == "schema":
        path = tmp_path / "schemas" / "gap.fbs"
        path.write_text(path.read_text().replace("(id: 3);", "= 7 (id: 3);"))
    else:
        path = tmp_path / "covinz" / "wire" / "layout.py"
        path.write_text(path.read_text().replace("'GAP1'", "'GAP2'"))
    assert generate_check(tmp_path) == 1


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.stem)
def test_every_field_says_what_it_is_and_who_sets_it(path: Path) -> None:
    lines = path.read_text().splitlines()
    comment = ""
    for line in lines:
        if line.strip().startswith("///"):
            comment += " " + line.strip().removeprefix("///").strip()
            continue
        if FIELD.match(line):
            assert re.search(r"set by |copied by |As in ", comment), line
        comment = ""


def test_every_message_has_an_identifier_of_its_own() -> None:
    identifiers = list(layout.MESSAGES.values())
    assert len(set(identifiers)) == len(identifiers)
    assert all(re.fullmatch(r"[A-Z]{3}[1-9]", identifier) for identifier in identifiers)
    assert len(identifiers) == len(SCHEMAS) - 1  # all but common.fbs


def test_readme_lists_every_message() -> None:
    text = (ROOT / "schemas" / "README.md").read_text()
    for name, identifier in layout.MESSAGES.items():
        assert f"`{name}`" in text
        assert f"`{identifier}`" in text
