"""The file that lets a robot in: what it says, who may read it, and how it can be wrong."""

from __future__ import annotations

import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from covinz.access import credentials
from covinz.access.credentials import Credentials, CredentialsError, agent_bus, with_credentials
from covinz.config import BusConfig

PEM = "-----BEGIN X-----\nQQ==\n-----END X-----\n"
GOOD = Credentials(
    name="a1",
    role="agent",
    endpoint="tls/h:7447",
    until=datetime.now(UTC).replace(microsecond=0) + timedelta(days=1),
    authority=PEM,
    certificate=PEM,
    key=PEM,
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a1.covinz"
    credentials.write_secret(path, GOOD.text())
    return path


def test_a_file_gives_back_what_was_written(file: Path) -> None:
    assert credentials.read(file) == GOOD
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert PEM.replace("\n", "\n  ").strip() in file.read_text()


def test_a_secret_takes_the_place_of_a_file_that_all_could_read(tmp_path: Path) -> None:
    path = tmp_path / "a1.covinz"
    path.write_text("old")
    path.chmod(0o644)
    credentials.write_secret(path, "new")
    assert (path.read_text(), stat.S_IMODE(path.stat().st_mode)) == ("new", 0o600)
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "name: Field required"),
        ("- 1", "expected a mapping"),
        (GOOD.text().replace("role: agent", "role: king"), "role"),
        (GOOD.text().replace("key: |", "kye: |"), "kye: there is no such setting"),
        (GOOD.text().replace("-----BEGIN X-----", "-----X-----"), "authority is not PEM"),
        (GOOD.text().replace("Z'", "'"), "time zone"),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, text: str, reason: str) -> None:
    file = tmp_path / "a1.covinz"
    file.write_text(text)
    with pytest.raises(CredentialsError, match=reason) as failure:
        credentials.read(file)
    assert str(file) in str(failure.value)


def test_a_missing_file_says_who_makes_it(tmp_path: Path) -> None:
    with pytest.raises(CredentialsError, match="`covinz roster add NAME` on the server"):
        credentials.read(tmp_path / "none")


def test_the_endpoint_is_that_of_the_file_unless_another_is_given(file: Path) -> None:
    config = BusConfig(max_message_bytes=5)
    assert with_credentials(config, file) == BusConfig(
        endpoint="tls/h:7447", credentials=file, max_message_bytes=5
    )
    assert with_credentials(config, file, "quic/h:1").endpoint == "quic/h:1"
    assert agent_bus("a1", config, file) == with_credentials(config, file)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"name": "a2"}, "of a2, not a1"),
        ({"role": "server"}, "of a1, not a1"),
        ({"until": datetime.now(UTC) - timedelta(seconds=1)}, "expired on .* --replace"),
    ],
)
def test_a_robot_refuses_what_would_not_let_it_in(
    file: Path, changes: dict[str, object], reason: str
) -> None:
    credentials.write_secret(file, GOOD.model_copy(update=changes).text())
    with pytest.raises(CredentialsError, match=reason):
        agent_bus("a1", BusConfig(), file)
