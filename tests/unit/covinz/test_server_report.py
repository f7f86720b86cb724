"""The player's summary is found, or it is said what is missing; the rest is in tests/system."""

from __future__ import annotations

from pathlib import Path

import pytest

from covinz.run import RunFailed
from covinz.server_report import SUMMARY_FILE, read_summary


def test_the_robots_of_a_summary(tmp_path: Path) -> None:
    (tmp_path / SUMMARY_FILE).write_text('{"agents": {"a0": {"keyframes": 3}}}')
    assert read_summary(tmp_path) == {"a0": {"keyframes": 3}}


@pytest.mark.parametrize("content", [None, "", "{", "[]", "{}"])
def test_what_is_no_summary(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / SUMMARY_FILE).write_text(content)
    with pytest.raises(RunFailed, match=f"--summary {tmp_path / SUMMARY_FILE}"):
        read_summary(tmp_path)
