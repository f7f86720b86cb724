"""A roster: members come and go, and what is written is what the router reads."""

from __future__ import annotations

import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from cryptography.x509.verification import ExtensionPolicy, PolicyBuilder, Store, VerificationError

from covinz.access import certificates, credentials
from covinz.access.enrolment import LOCAL_HOSTS, Request, add, remove
from covinz.access.roster import SERVER, Identity, Roster, RosterError, read_identity


@pytest.fixture
def roster(tmp_path: Path) -> Roster:
    return Roster(tmp_path / "data" / "roster")


def certificate(pem: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate(pem.encode())


def purposes(pem: str) -> list[x509.ObjectIdentifier]:
    return list(certificate(pem).extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)


def trusts(authorities: list[str], pem: str, *between: str) -> bool:
    """Whether who trusts these authorities lets a client with this certificate in."""
    builder = PolicyBuilder().store(Store([certificate(one) for one in authorities]))
    builder = builder.extension_policies(
        ca_policy=ExtensionPolicy.webpki_defaults_ca(), ee_policy=ExtensionPolicy.permit_all()
    )
    try:
        builder.build_client_verifier().verify(
            certificate(pem), [certificate(one) for one in between]
        )
    except VerificationError:
        return False
    return True


def names(pem: str) -> set[str]:
    found = certificate(pem).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    addresses = [str(address) for address in found.get_values_for_type(x509.IPAddress)]
    return {*addresses, *found.get_values_for_type(x509.DNSName)}


def test_the_first_member_makes_the_roster(roster: Roster) -> None:
    assert not roster.exists()
    made = add(roster, Request("a1", host="10.8.0.1"))
    assert (made.name, made.role, made.endpoint) == ("a1", "agent", "tls/10.8.0.1:7447")
    access = roster.router_access()
    assert access.members == {"a1": "agent", SERVER: "server"}
    assert access.identity == read_identity(roster.router)
    assert names(access.identity.certificate_pem) == {*LOCAL_HOSTS, "10.8.0.1"}
    own = credentials.read(roster.server_credentials)
    assert (own.name, own.role, own.endpoint) == (SERVER, "server", "tls/127.0.0.1:7447")


def test_certificates_say_who_it_is_and_serve_one_purpose(roster: Roster) -> None:
    made = add(roster, Request("a1", host="example.org"))
    assert certificates.common_name(made.certificate) == "agent.a1"
    assert purposes(made.certificate) == [ExtendedKeyUsageOID.CLIENT_AUTH]
    router = read_identity(roster.router).certificate_pem
    assert purposes(router) == [ExtendedKeyUsageOID.SERVER_AUTH]
    for pem, is_authority in ((made.certificate, False), (router, False), (made.authority, True)):
        constraints = certificate(pem).extensions.get_extension_for_class(x509.BasicConstraints)
        assert (constraints.critical, constraints.value.ca) == (True, is_authority)


def test_a_member_is_signed_by_its_own_authority_and_by_no_other(roster: Roster) -> None:
    made = {name: add(roster, Request(name, host="h")) for name in ("a1", "a2")}
    for name, one in made.items():
        for other, member in roster.read().members.items():
            assert trusts([member.authority], one.certificate) == (name == other)


def test_nothing_secret_of_a_robot_stays(roster: Roster) -> None:
    made = add(roster, Request("a1", host="h"))
    kept = "".join(file.read_text() for file in roster.folder.iterdir())
    assert made.key not in kept
    assert kept.count("PRIVATE KEY-----\n") == 2 * len(("authority", "router", "server"))
    assert "PRIVATE KEY" not in roster.file.read_text()


def test_only_the_owner_can_read(roster: Roster) -> None:
    add(roster, Request("a1", host="h"))
    files = [*roster.folder.iterdir()]
    assert len(files) == 5
    assert {stat.S_IMODE(file.stat().st_mode) for file in files} == {0o600}
    assert stat.S_IMODE(roster.folder.stat().st_mode) == 0o700


def test_robots_trust_the_router_also_when_a_host_was_added_later(roster: Roster) -> None:
    first = add(roster, Request("a1", host="10.8.0.1"))
    version = roster.version()
    second = add(roster, Request("a2", host="2001:db8::1"))
    assert roster.version() != version
    assert second.endpoint == "tls/[2001:db8::1]:7447"
    assert first.authority == second.authority
    router = read_identity(roster.router).certificate_pem
    assert {"10.8.0.1", "2001:db8::1"} <= names(router)
    certificate(router).verify_directly_issued_by(certificate(first.authority))


def test_the_first_host_is_what_later_robots_are_given(roster: Roster) -> None:
    add(roster, Request("a1", host="one.example.org", port=8000))
    add(roster, Request("a2", host="two.example.org"))
    made = add(roster, Request("a3", transport="quic"))
    assert made.endpoint == "quic/one.example.org:8000"
    assert credentials.read(roster.server_credentials).endpoint == "tls/127.0.0.1:8000"


def test_lifetimes(roster: Roster) -> None:
    before = datetime.now(UTC)
    made = add(roster, Request("a1", host="h", lifetime=timedelta(days=3)))
    assert certificates.until(made.certificate) == made.until == roster.read().members["a1"].until
    assert abs(made.until - before - timedelta(days=3)) < timedelta(minutes=1)
    assert certificate(made.certificate).not_valid_before_utc <= before - timedelta(hours=23)


def test_a_member_that_was_removed_is_not_trusted(roster: Roster) -> None:
    made = add(roster, Request("a1", host="h"))
    add(roster, Request("a2"))
    authority = roster.read().members["a1"].authority
    assert authority in roster.router_access().trusted_pem
    remove(roster, "a1")
    access = roster.router_access()
    assert set(access.members) == {"a2", SERVER}
    assert authority not in access.trusted_pem
    again = add(roster, Request("a1"))
    assert again.certificate != made.certificate
    assert authority not in roster.router_access().trusted_pem


def test_a_name_is_replaced_only_on_demand(roster: Roster) -> None:
    first = add(roster, Request("a1", host="h"))
    with pytest.raises(RosterError, match="--replace"):
        add(roster, Request("a1"))
    second = add(roster, Request("a1", replace=True))
    assert first.key != second.key
    assert len(roster.read().members) == 2


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        (Request("A1", host="h"), "cannot be a name"),
        (Request("../x", host="h"), "cannot be a name"),
        (Request(SERVER, host="h"), "cannot be a name"),
        (Request("a1"), "--server HOST"),
        (Request("a1", host="b d"), "no host name"),
        (Request("a1", host="h:7447"), "no host name"),
        (Request("a1", host=""), "no host name"),
    ],
)
def test_what_cannot_be_added(roster: Roster, request_: Request, reason: str) -> None:
    with pytest.raises(RosterError, match=reason):
        add(roster, request_)
    assert not roster.exists()


@pytest.mark.parametrize("name", ["nobody", SERVER])
def test_what_cannot_be_removed(roster: Roster, name: str) -> None:
    add(roster, Request("a1", host="h"))
    with pytest.raises(RosterError, match="not in the roster: a1"):
        remove(roster, name)


def test_a_damaged_roster_is_named(roster: Roster) -> None:
    with pytest.raises(RosterError, match="covinz roster add"):
        roster.read()
    add(roster, Request("a1", host="h"))
    good = roster.file.read_text()
    for bad in ("members: {a1: {role: king}}", "members: [", "hosts: 1"):
        roster.file.write_text(bad)
        with pytest.raises(RosterError, match=r"roster\.yaml"):
            roster.router_access()
    roster.file.write_text(good)
    roster.router.write_text("gone")
    with pytest.raises(RosterError, match=r"router\.pem"):
        roster.router_access()


def test_members_cannot_sign_for_others(roster: Roster) -> None:
    ours = add(roster, Request("a1", host="h"))
    add(roster, Request("a2"))
    until = datetime.now(UTC) + timedelta(days=1)
    forged = certificates.client_identity(Identity(ours.certificate, ours.key), "agent.a2", until)
    trusted = [member.authority for member in roster.read().members.values()]
    assert trusts(trusted, ours.certificate)
    assert not trusts(trusted, forged.certificate_pem, ours.certificate)
