"""Proxies of docs/operate/service.md, copied from the page: log-in, commands and stream through TLS."""

import asyncio
import re
import shutil
import socket
import ssl
import subprocess
from pathlib import Path

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from softarm.schemas.config import Config
from tests.processes import free_port, until

PAGE = Path(__file__).parents[3] / "docs/operate/service.md"
NAME = "arm.example.org"
TOKEN = "c" * 32

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is missing"),
]


def answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port)).close()
    except ConnectionRefusedError:
        return False
    return True


def example(language: str, *changes: tuple[str, str]) -> str:
    """Return the page's configuration of a proxy with this test's ports and certificate."""
    text = re.search(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1]
    for was, now in changes:
        assert was in text
        text = text.replace(was, now)
    return text


def nginx(folder: Path, api_port: int, port: int) -> list[str | Path]:
    """Return the command that runs nginx."""
    server = example(
        "nginx",
        ("listen 443 ssl", f"listen 127.0.0.1:{port} ssl"),
        ("http://127.0.0.1:8080", f"http://127.0.0.1:{api_port}"),
        (f"/etc/ssl/{NAME}.pem", str(folder / "cert.pem")),
        (f"/etc/ssl/{NAME}.key", str(folder / "key.pem")),
    )
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    paths = "".join(f"{kind}_temp_path {folder}/{kind};" for kind in kinds)
    conf = folder / "nginx.conf"
    conf.write_text(
        f"daemon off; pid {folder}/pid; error_log {folder}/error.log;\n"
        f"events {{}}\nhttp {{ access_log off; {paths}\n{server}\n}}\n"
    )
    return ["nginx", "-p", folder, "-c", conf, "-e", folder / "early.log"]


def caddy(folder: Path, api_port: int, port: int) -> list[str | Path]:
    """Return the command that runs Caddy; a local certificate avoids fetching one."""
    own = f"    bind 127.0.0.1\n    tls {folder / 'cert.pem'} {folder / 'key.pem'}\n"
    site = example(
        "Caddyfile", (f"{NAME} {{\n", f"{NAME}:{port} {{\n{own}"), ("127.0.0.1:8080", f"127.0.0.1:{api_port}")
    )
    conf = folder / "Caddyfile"
    conf.write_text(f"{{\n    admin off\n    auto_https disable_redirects\n}}\n{site}")
    return ["caddy", "run", "--config", conf, "--adapter", "caddyfile"]


@pytest.fixture(params=[nginx, caddy], ids=lambda proxy: proxy.__name__)
def proxied(request, loop, app, serving, tokens, tmp_path, monkeypatch):
    """Yield the proxy's port and a TLS context that trusts its certificate."""
    if shutil.which(request.param.__name__) is None:
        pytest.skip(f"{request.param.__name__} is missing")
    for folder in ("XDG_DATA_HOME", "XDG_CONFIG_HOME"):  # caddy's own
        monkeypatch.setenv(folder, str(tmp_path))
    made = f"req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN={NAME} -addext subjectAltName=DNS:{NAME}".split()
    written = ["-keyout", tmp_path / "key.pem", "-out", tmp_path / "cert.pem"]
    subprocess.run(["openssl", *made, *written], check=True, capture_output=True)
    port = free_port()
    config = Config(api={"port": 0, "public_origin": f"https://{NAME}:{port}"} | tokens(token_file=TOKEN))
    with serving(app(loop, config), config.api) as api_port:
        proxy = subprocess.Popen(request.param(tmp_path, api_port, port))
        try:
            until(lambda: answers(port) or proxy.poll() is not None)
            assert proxy.poll() is None, "the proxy ended; see its message above"
            yield port, ssl.create_default_context(cafile=tmp_path / "cert.pem")
        finally:
            proxy.terminate()
            proxy.wait(timeout=10)


def test_a_browser_logs_in_commands_and_streams_through_tls(proxied, loop):
    port, trust = proxied
    page = {"Origin": f"https://{NAME}:{port}", "Host": f"{NAME}:{port}"}
    with httpx.Client(base_url=f"https://127.0.0.1:{port}", verify=trust, headers=page, trust_env=False) as browser:
        named = {"extensions": {"sni_hostname": NAME}}
        assert browser.get("/api/status", **named).status_code == 401
        answer = browser.post("/api/login", json={"token": TOKEN}, **named)
        assert answer.status_code == 200
        assert answer.headers["set-cookie"].endswith("SameSite=Strict; Secure")
        cookie = {"Cookie": answer.headers["set-cookie"].partition(";")[0]}
        assert browser.post("/api/arm", headers=cookie, **named).status_code == 200
        assert loop.taken[-1].request.who == "the dashboard (command token)"
        forged = {"Origin": "https://evil.example"}
        assert browser.post("/api/disarm", headers=cookie | forged, **named).status_code == 403
        ticket = browser.post("/api/ticket", headers=cookie, **named).json()["ticket"]
    address = f"wss://{NAME}:{port}/api/stream?ticket={ticket}"
    assert '"mode":"armed"' in asyncio.run(first_status(address, trust, page["Origin"]))
    with pytest.raises(InvalidStatus):
        asyncio.run(first_status(address, trust, page["Origin"]))


async def first_status(address: str, trust: ssl.SSLContext, origin: str) -> str:
    """Return the first message of a stream. One thread: Python 3.11 may not read and write TLS in two at once."""
    async with connect(address, host="127.0.0.1", ssl=trust, server_hostname=NAME, origin=origin, proxy=None) as stream:
        return await stream.recv()
