"""X.509 certificates of a fleet; the only importer of `cryptography`.

Two kinds of authorities, so that neither side can play the other: the server's signs the router's
certificate and is what robots trust; each member of the roster has an authority of its own, which
signs one certificate and whose key nobody keeps. Source: decision 0024.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from ipaddress import ip_address

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from covinz.access.roster import Identity

# A robot whose clock is behind by less finds a new certificate valid.
CLOCK_TOLERANCE = timedelta(days=1)
# The curve that all of TLS 1.3 must support.
_CURVE = ec.SECP256R1()


class CertificateError(ValueError):
    """A certificate or key that cannot be read or made."""


def new_authority(common_name: str, until: datetime) -> Identity:
    """An authority that may sign certificates, but no further authorities."""
    key = ec.generate_private_key(_CURVE)
    name = _name(common_name)
    builder = _builder(name, name, key.public_key(), until).add_extension(
        x509.BasicConstraints(ca=True, path_length=0), critical=True
    )
    builder = builder.add_extension(_key_usage(signs_certificates=True), critical=True)
    return _signed(builder, key, key, key.public_key())


def client_identity(authority: Identity, common_name: str, until: datetime) -> Identity:
    """A certificate to connect with, and for nothing else."""
    return _identity(authority, common_name, until, ExtendedKeyUsageOID.CLIENT_AUTH, ())


def router_identity(authority: Identity, hosts: tuple[str, ...], until: datetime) -> Identity:
    """A certificate to listen with, under these host names and IP addresses."""
    return _identity(authority, "covinz router", until, ExtendedKeyUsageOID.SERVER_AUTH, hosts)


def until(certificate_pem: str) -> datetime:
    """When a certificate expires (UTC); raises CertificateError when it is none."""
    return _certificate(certificate_pem).not_valid_after_utc


def common_name(certificate_pem: str) -> str:
    """The name of a certificate's subject; raises CertificateError when it has none."""
    names = _certificate(certificate_pem).subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    if len(names) != 1:
        raise CertificateError("a certificate without one common name")
    return str(names[0].value)


def _identity(
    authority: Identity,
    common_name: str,
    until: datetime,
    purpose: x509.ObjectIdentifier,
    hosts: tuple[str, ...],
) -> Identity:
    issuer = _certificate(authority.certificate_pem)
    try:
        issuer_key = load_pem_private_key(authority.key_pem.encode(), password=None)
    except (ValueError, TypeError) as error:
        raise CertificateError(f"not a private key: {error}") from error
    if not isinstance(issuer_key, ec.EllipticCurvePrivateKey):
        raise CertificateError("the authority's key is of a kind that covinz does not make")
    key = ec.generate_private_key(_CURVE)
    builder = _builder(_name(common_name), issuer.subject, key.public_key(), until)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
    builder = builder.add_extension(_key_usage(signs_certificates=False), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
    if hosts:
        names = x509.SubjectAlternativeName([_host(host) for host in hosts])
        builder = builder.add_extension(names, critical=False)
    return _signed(builder, key, issuer_key, issuer_key.public_key())


def _builder(
    subject: x509.Name, issuer: x509.Name, public_key: ec.EllipticCurvePublicKey, until: datetime
) -> x509.CertificateBuilder:
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer)
    builder = builder.public_key(public_key).serial_number(x509.random_serial_number())
    # An authority that was kept for years and one that was just made begin before their members.
    begin = min(datetime.now(UTC), until) - CLOCK_TOLERANCE
    return builder.not_valid_before(begin).not_valid_after(until)


def _signed(
    builder: x509.CertificateBuilder,
    key: ec.EllipticCurvePrivateKey,
    issuer_key: ec.EllipticCurvePrivateKey,
    issuer_public: ec.EllipticCurvePublicKey,
) -> Identity:
    subject_id = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    issuer_id = x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_public)
    builder = builder.add_extension(subject_id, critical=False)
    builder = builder.add_extension(issuer_id, critical=False)
    certificate = builder.sign(issuer_key, hashes.SHA256())
    key_bytes = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return Identity(certificate.public_bytes(Encoding.PEM).decode(), key_bytes.decode())


def _certificate(pem: str) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(pem.encode())
    except ValueError as error:
        raise CertificateError(f"not a certificate: {error}") from error


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError as error:
        raise CertificateError(f"not a host name: {host!r}") from error


def _key_usage(signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
