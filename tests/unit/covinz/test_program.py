from __future__ import annotations

import tomllib
from pathlib import Path

from covinz.codec.values import VERSION as WELL_FORMED
from covinz.program import NUMBER, VERSION


def test_the_version_is_that_of_the_package() -> None:
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    assert project["version"] == NUMBER
    assert WELL_FORMED.fullmatch(VERSION)
