"""What a report says of how it was made."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from covinz import config, provenance


def git(folder: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=a", "-c", "user.email=a@b")
    command = ["git", "-C", str(folder), *identity, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def test_only_settings_that_differ_are_named() -> None:
    changed = config.validate(
        config.Config,
        {
            "bus": {"endpoint": "tcp/127.0.0.1:1", "query_timeout_s": 3.0},
            "place_recognition": {"num_candidates": 2},
            "optimizer": {"odometry": {"min_rotation": 0.1}},
        },
        "test",
    )
    assert provenance.differences(changed) == {
        "bus": {"query_timeout_s": 3.0},
        "place_recognition": {"num_candidates": 2},
        "optimizer": {"odometry": {"min_rotation": 0.1}},
    }


def test_the_address_of_a_run_is_no_setting() -> None:
    values = {"bus": {"endpoint": "tcp/127.0.0.1:1"}}
    assert provenance.differences(config.validate(config.Config, values, "test")) == {}


def test_a_revision_says_when_files_differ_from_it(tmp_path: Path) -> None:
    assert provenance.revision(tmp_path) is None
    git(tmp_path, "init", "-q")
    assert provenance.revision(tmp_path) is None
    (tmp_path / "file").write_text("one")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "-q", "-m", "one")
    commit = provenance.revision(tmp_path)
    assert commit and git(tmp_path, "rev-parse", "HEAD").startswith(commit)
    (tmp_path / "file").write_text("two")
    assert provenance.revision(tmp_path) == f"{commit}-dirty"


def test_outside_of_a_machine_with_git_there_is_no_revision(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    git(tmp_path, "init", "-q")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert provenance.revision(tmp_path) is None
