"""Why a router does not let us in, in words: Zenoh only says that it did not."""

from __future__ import annotations

import socket
import ssl
import tempfile
from pathlib import Path

from covinz.access import credentials
from covinz.access.credentials import Credentials, CredentialsError, write_secret
from covinz.bus import endpoints
from covinz.config import BusConfig

_TIMEOUT_S = 3.0
# A router that refuses a certificate says so at once after the handshake; else it says nothing.
_REFUSAL_S = 0.5
# What OpenSSL calls the router's refusals, and what they mean here.
_REFUSALS = {
    "UNKNOWN_CA": "it does not know these credentials: {name} was removed from its roster, or "
    "was given newer ones (`covinz roster add {name} --replace` makes new ones)",
    "CERTIFICATE_EXPIRED": "these credentials expired on {until:%Y-%m-%d %H:%M} UTC "
    "(`covinz roster add {name} --replace` makes new ones), or its clock is wrong",
    "DECRYPT_ERROR": "these credentials are of another fleet",
    "CERTIFICATE_UNKNOWN": "it does not accept this certificate",
    "CERTIFICATE_REQUIRED": "it asks for a certificate",
}


def why_not(config: BusConfig) -> str:
    """Try to reach the router of `config` without Zenoh and say what is in the way.

    Takes a few seconds at most. QUIC is looked at through TLS on the same port, where our router
    listens too.
    """
    endpoint = endpoints.parse(config.endpoint)
    try:
        own = None if config.credentials is None else credentials.read(config.credentials)
    except CredentialsError as error:
        return str(error)
    if own is not None and own.is_expired:
        return _REFUSALS["CERTIFICATE_EXPIRED"].format(name=own.name, until=own.until)
    try:
        link = socket.create_connection((endpoint.host, endpoint.port), _TIMEOUT_S)
    except socket.gaierror:
        return f"there is no host {endpoint.host}"
    except ConnectionRefusedError:
        return "nobody listens there; is the server up?"
    except OSError as error:
        return f"no connection: {error.strerror or error}"
    with link:
        if not endpoint.is_encrypted:
            return (
                "somebody listens, but not for plain connections, or hangs; a server with a roster "
                "needs credentials (NAME.covinz)"
            )
        assert own is not None, "sessions with TLS are not opened without credentials"
        return _handshake(link, endpoint.host, own)


def _handshake(link: socket.socket, host: str, own: Credentials) -> str:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(cadata=own.authority)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "own.pem"
            write_secret(file, own.certificate + own.key)
            context.load_cert_chain(file)
        with context.wrap_socket(link, server_hostname=host) as secured:
            secured.settimeout(_REFUSAL_S)
            secured.recv(1)
    except TimeoutError:
        return "it accepts these credentials; a session should open soon"
    except ssl.SSLCertVerificationError as error:
        return _distrusted(error, host)
    except ssl.SSLError as error:
        for word, meaning in _REFUSALS.items():
            if word in (error.reason or ""):
                return meaning.format(name=own.name, until=own.until)
        return f"it does not speak our TLS ({error.reason}); is this a covinz server with a roster?"
    except OSError as error:
        return f"the connection ended: {error.strerror or error}"
    return "it closes the connection"


def _distrusted(error: ssl.SSLCertVerificationError, host: str) -> str:
    if "mismatch" in error.verify_message or "not valid for" in error.verify_message:
        return (
            f"its certificate is not for {host}; on the server `covinz roster add NAME --server "
            f"{host}` adds that name"
        )
    if error.verify_code in (9, 10):  # not yet valid, expired
        return f"its certificate: {error.verify_message}; is this machine's clock right?"
    return f"it is not the server that these credentials are for ({error.verify_message})"
