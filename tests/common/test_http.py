"""Tests of the HTTP client."""

import ssl
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import httpx
import pytest

from softarm.common import http
from tests.tls import certified


@pytest.fixture
def loads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the certificate files that are loaded."""
    loaded: list[str] = []
    create = ssl.create_default_context

    def recorded(*args: object, cafile: str | None = None, **options: object) -> ssl.SSLContext:
        loaded.append(str(cafile))
        return create(*args, cafile=cafile, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(ssl, "create_default_context", recorded)
    return loaded


def test_certificates_are_loaded_for_https_only(loads: list[str]) -> None:
    with http.client("http://127.0.0.1:8000"):
        assert loads == []
    with http.client("https://127.0.0.1:8443"):
        assert len(loads) == 1


def test_a_proxy_of_the_environment_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    with http.client("http://127.0.0.1:8000") as client:
        assert client.trust_env is False


def test_an_authority_of_this_computer_is_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    context, certificate = certified(tmp_path)
    with HTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as server:
        server.socket = context.wrap_socket(server.socket, server_side=True)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"https://localhost:{server.server_port}"
        with http.client(url) as client, pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            client.get("/")
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
        with http.client(url) as client:
            assert client.get("/").status_code == 501
        server.shutdown()
