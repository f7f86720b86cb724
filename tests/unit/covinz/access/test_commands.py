"""`covinz roster`: what is written where, and what is said."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from covinz.access import credentials
from covinz.access.commands import app
from covinz.access.roster import Roster


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return tmp_path / "data"


def run(data: Path, *arguments: str) -> Result:
    return CliRunner().invoke(app, [*arguments, "--data", str(data)], env={"COLUMNS": "200"})


def test_one_file_is_written_for_the_robot(data: Path, tmp_path: Path) -> None:
    file = tmp_path / "r1.covinz"
    done = run(data, "add", "r1", "--server", "h", "--transport", "quic", "--out", str(file))
    assert done.exit_code == 0
    assert "r1 may connect to quic/h:7447 until " in done.output
    assert credentials.read(file).endpoint == "quic/h:7447"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_credentials_can_be_printed_and_then_nothing_else_is(data: Path, tmp_path: Path) -> None:
    done = run(data, "add", "r1", "--server", "h", "--days", "3", "--out", "-")
    file = tmp_path / "printed"
    file.write_text(done.stdout)
    assert credentials.read(file).text() == done.stdout


def test_who_cannot_be_given_a_file_is_not_let_in(data: Path, tmp_path: Path) -> None:
    nowhere = tmp_path / "none" / "r1.covinz"
    done = run(data, "add", "r1", "--server", "h", "--out", str(nowhere))
    assert isinstance(done.exception, FileNotFoundError)
    assert run(data, "list").exception is None
    assert set(Roster(data / "roster").read().members) == {"server"}


def test_the_list_says_who_may_what_until_when(data: Path) -> None:
    run(data, "add", "r1", "--server", "10.8.0.1", "--days", "3", "--out", "-")
    run(data, "add", "anna", "--operator", "--out", "-")
    lines = run(data, "list").output.splitlines()
    (robot,) = [line for line in lines if "r1" in line]
    (person,) = [line for line in lines if "anna" in line]
    assert "send, be corrected" in robot and "2 days" in robot
    assert "everything" in person
    assert lines[-1] == "at 10.8.0.1, port 7447"
    assert "r1 may not connect" in run(data, "remove", "r1").output
    assert "r1" not in run(data, "list").output
