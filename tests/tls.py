"""A server certificate of localhost, made by openssl."""

import shutil
import ssl
import subprocess
from pathlib import Path

import pytest


def certified(folder: Path) -> tuple[ssl.SSLContext, Path]:
    """Return the context of a server, and the certificate that its clients must trust."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is missing")
    key, certificate = folder / "key.pem", folder / "cert.pem"
    named = ("-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-keyout", key, "-out", certificate)
    command = ("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", *named)
    subprocess.run(command, check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    return context, certificate
