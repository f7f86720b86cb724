"""Where a server listens, and when it refuses to."""

from __future__ import annotations

from pathlib import Path

import pytest

from covinz.access.enrolment import Request, add
from covinz.access.roster import Roster, RosterError
from covinz.access.server import server_bus
from covinz.bus import BusError, endpoints
from covinz.bus.endpoints import Endpoint
from covinz.bus.settings import client_settings, listening, router_settings
from covinz.config import BusConfig


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "data" / "roster"


def test_without_a_roster_a_server_is_as_configured(folder: Path) -> None:
    config = BusConfig(endpoint="tcp/127.0.0.1:1")
    assert server_bus(config, folder, None) == config
    with pytest.raises(RosterError, match=f"roster add NAME --server HOST --data {folder.parent}"):
        server_bus(config, folder, "0.0.0.0")


@pytest.mark.parametrize(
    ("listen", "where"),
    [
        (None, ["tls/127.0.0.1:8000", "quic/127.0.0.1:8000"]),
        ("0.0.0.0", ["tls/0.0.0.0:8000", "quic/0.0.0.0:8000"]),
        ("::", ["tls/[::]:8000", "quic/[::]:8000"]),
        (
            "10.8.0.1",
            [
                "tls/127.0.0.1:8000",
                "quic/127.0.0.1:8000",
                "tls/10.8.0.1:8000",
                "quic/10.8.0.1:8000",
            ],
        ),
    ],
)
def test_with_a_roster_everything_is_encrypted(
    folder: Path, listen: str | None, where: list[str]
) -> None:
    add(Roster(folder), Request("a1", host="10.8.0.1", port=8000))
    bus = server_bus(BusConfig(), folder, listen)
    assert listening(bus) == where
    assert bus.endpoint == "tls/127.0.0.1:8000"
    assert (bus.roster, bus.credentials) == (folder, folder / "server.covinz")
    for settings in (router_settings(bus), client_settings(bus)):
        assert settings.get_json("transport/link/tls/enable_mtls") == "true"


def test_where_to_listen_can_be_told_exactly(folder: Path) -> None:
    add(Roster(folder), Request("a1", host="h"))
    config = BusConfig(endpoint="tls/127.0.0.1:9", listen=("tls/127.0.0.1:9",))
    bus = server_bus(config, folder, None)
    assert (bus.endpoint, bus.listen, bus.roster) == (config.endpoint, config.listen, folder)


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:1", "tcp/10.0.0.1:1", "udp/h:1", "ws/[::]:1"])
def test_nothing_is_open_in_the_clear(endpoint: str) -> None:
    with pytest.raises(BusError, match="without encryption or access control"):
        listening(BusConfig(endpoint=endpoint))
    with pytest.raises(BusError, match="without encryption or access control"):
        listening(BusConfig(listen=("tcp/127.0.0.1:1", endpoint)))
    assert listening(BusConfig(endpoint=endpoint, insecure=True)) == [endpoint]


@pytest.mark.parametrize(
    "endpoint", ["tcp/127.0.0.1:1", "tcp/localhost:1", "tcp/[::1]:1", "unixsock-stream//tmp/s"]
)
def test_this_machine_may_connect_in_the_clear(endpoint: str) -> None:
    assert listening(BusConfig(endpoint=endpoint)) == [endpoint]


def test_encryption_needs_to_know_who_is_who(folder: Path) -> None:
    with pytest.raises(BusError, match="without a roster"):
        listening(BusConfig(endpoint="tls/127.0.0.1:1"))
    with pytest.raises(BusError, match="there is no roster in"):
        router_settings(BusConfig(endpoint="tls/127.0.0.1:1", roster=folder))
    with pytest.raises(BusError, match=r"needs credentials: the file NAME\.covinz"):
        client_settings(BusConfig(endpoint="quic/127.0.0.1:1"))
    with pytest.raises(BusError, match="no usable credentials"):
        client_settings(BusConfig(endpoint="quic/h:1", credentials=folder / "none"))


def test_endpoints_are_taken_apart() -> None:
    assert endpoints.parse("tls/[::1]:7447") == Endpoint("tls", "::1", 7447)
    assert endpoints.parse("tcp/h:0?rel=1#iface=lo") == Endpoint("tcp", "h", 0)
    for bad in ("", "tcp", "tcp/", "tcp/h", "tcp/:1", "tcp/h:", "tcp/h:x", "tcp/h:65536", "/h:1"):
        with pytest.raises(BusError, match="not an endpoint"):
            endpoints.parse(bad)
