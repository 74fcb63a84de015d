"""Requests of clients: to the REST API with and without its web server, and to the dedicated stop port."""

import asyncio
import contextlib
import json
import logging
import socket
import threading
from collections.abc import Callable, Mapping
from random import Random
from typing import Any, NamedTuple

from softarm.daemon.api.app import create_app
from softarm.daemon.api.context import ApiContext
from softarm.daemon.api.server import ApiServer
from softarm.daemon.control.inbox import Inbox
from softarm.daemon.control.records import Outputs
from softarm.daemon.runtime.offline import Lockstep
from softarm.daemon.stop.listener import StopListener
from softarm.policies.base import Policy, PolicyError
from softarm.policies.hold import Hold
from softarm.policies.registry import PolicyEntry
from softarm.schemas.config import Api, Config
from validation.fuzz import mutate
from validation.fuzz.parsers.base import Parser

PATIENCE_S = 10.0
_ALLOWED = {200, 400, 403, 404, 405, 408, 409, 411, 413, 422, 431, 503}
_METHODS = ("GET", "POST", "PUT", "DELETE", "HEAD", "OPTIONS", "PATCH", "", "get", "POST\0")
_PATHS = (
    "/api/goal",
    "/api/policy",
    "/api/arm",
    "/api/stop",
    "/api/status",
    "/api/health",
    "/api/stream",
    "/docs",
    "/",
)
_BODIES: tuple[Any, ...] = (
    {"kind": "reach", "y_m": -0.2, "z_m": 0.65},
    {"kind": "hold"},
    {"kind": "run"},
    {"name": "hold"},
)
_HEADERS = (
    (b"content-type", b"application/json"),
    (b"content-length", b"40"),
    (b"transfer-encoding", b"chunked"),
    (b"origin", b"http://127.0.0.1"),
    (b"authorization", b"Bearer 0123456789abcdef0123456789abcdef"),
    (b"host", b"127.0.0.1:8080"),
    (b"expect", b"100-continue"),
    (b"cookie", b"a=b"),
)


class _Policies:
    """Stand-in with one policy and none that loads, since policies are not under test here."""

    def available(self) -> Mapping[str, PolicyEntry]:
        return {"hold": PolicyEntry("hold", "hold", spec=Hold.spec)}

    def load(self, name: str) -> Policy:
        raise PolicyError(f"policy '{name}': not here; choose another")


class _Robot:
    """Controller with a robot in lockstep that ticks on every access."""

    def __init__(self) -> None:
        self.inbox = Inbox()
        self._lockstep = Lockstep(Config(), Hold())
        self._lock = threading.Lock()

    def snapshot(self) -> Outputs:
        """Return the newest outputs, after another tick."""
        with self._lock:
            return self._lockstep.tick(*(post.request for post in self.inbox.take()))

    def clock(self) -> int:
        """Return the robot's own time, so that no reading becomes stale."""
        return self._lockstep.robot.now_ns

    def app(self) -> Any:
        """Return the API of this robot."""
        context = ApiContext(Config(), self.inbox, self.snapshot, policies=_Policies(), clock=self.clock)
        return create_app(context)


class _Request(NamedTuple):
    method: str
    path: str
    query: bytes
    headers: list[tuple[bytes, bytes]]
    body: list[bytes]  # in pieces


def _draw_request(random: Random) -> _Request:
    body = mutate.to_json(random, mutate.of_tree(random, random.choice(_BODIES)))
    if random.random() < 0.05:
        body = b"[" * 4000
    headers = [(b"host", b"127.0.0.1"), (b"content-type", b"application/json")]
    for _ in range(random.randrange(3)):
        name, value = random.choice(_HEADERS)
        headers.append((name, mutate.of_bytes(random, [value])[:2000] if random.random() < 0.8 else value))
    path, query = random.choice(_PATHS[:4] if random.random() < 0.7 else _PATHS), b""
    if random.random() < 0.2:
        path = "/" + mutate.of_bytes(random, [each.encode() for each in _PATHS]).decode("latin-1")[:500]
        query = mutate.of_bytes(random, [b"hz=30&a=b"])
    method = random.choice(("POST", "PUT")) if random.random() < 0.7 else random.choice(_METHODS)
    cut = random.randint(0, len(body))
    return _Request(method, path, query, headers, [body[:cut], body[cut:]])


def _requests() -> Parser:
    """Return the parser of requests to the application without a web server."""
    app = _Robot().app()

    async def ask(request: _Request) -> tuple[int, bytes]:
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": request.method,
            "scheme": "http",
            "path": request.path,
            "raw_path": request.path.encode("latin-1", "replace"),
            "query_string": request.query,
            "root_path": "",
            "headers": request.headers,
            "client": ("127.0.0.1", 1),
            "server": ("127.0.0.1", 8080),
        }
        coming = [
            {"type": "http.request", "body": part, "more_body": i + 1 < len(request.body)}
            for i, part in enumerate(request.body)
        ]
        answer: list[dict[str, Any]] = []

        async def receive() -> dict[str, Any]:
            return coming.pop(0) if coming else {"type": "http.disconnect"}

        async def send(message: dict[str, Any]) -> None:
            answer.append(message)

        async with asyncio.timeout(PATIENCE_S):
            await app(scope, receive, send)
        return answer[0]["status"], b"".join(part.get("body", b"") for part in answer[1:])

    def take(request: _Request) -> None:
        status, body = asyncio.run(ask(request))
        assert status in _ALLOWED or 300 <= status < 400, f"answered {status}"
        if status >= 400 and request.method != "HEAD":
            said = json.loads(body)
            assert "healthy" in said or (said["detail"] and said["reasons"])

    return Parser(_draw_request, take, ())


def _raw_request(random: Random, path: bytes) -> list[bytes]:
    """Return a request as its bytes, in one or several pieces."""
    body = json.dumps(random.choice(_BODIES)).encode()
    head = b"POST %s HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n" % path
    good = [
        head + b"Content-Length: %d\r\n\r\n%s" % (len(body), body),
        head + b"Transfer-Encoding: chunked\r\n\r\n%x\r\n%s\r\n0\r\n\r\n" % (len(body), body),
        b"GET /api/status HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /api/stream?hz=5 HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n\x81\x85\1\2\3\4hello",
    ]
    data = mutate.of_bytes(random, good)
    if random.random() < 0.5:
        return [data]
    cut = random.randint(0, len(data))
    return [data[:cut], data[cut:]]


def _answer(port: int, parts: list[bytes]) -> bytes:
    """Return the answer until the connection closes or becomes idle."""
    received = b""
    connection = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
    with connection, contextlib.suppress(ConnectionError):  # the server closed the connection
        for part in parts:
            connection.sendall(part)
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_WR)
        while part := connection.recv(65536):
            received += part
    return received


def _listens(port: int, path: bytes) -> bool:
    answer = _answer(port, [b"POST %s HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n" % path])
    return answer.startswith(b"HTTP/1.1 200 ")


def _check_answer(answer: bytes) -> None:
    assert not answer or answer.startswith(b"HTTP/1.1 "), f"said {answer[:80]!r}"
    assert not answer.startswith(b"HTTP/1.1 5") or answer.startswith(b"HTTP/1.1 503"), f"said {answer[:200]!r}"


def _server() -> Parser:
    """Return the parser of the API behind its web server: no client may disturb the next one."""
    logging.getLogger("uvicorn").setLevel(logging.CRITICAL)
    robot = _Robot()
    server = ApiServer(Api(port=0), robot.app())
    port = server.start()

    def take(parts: list[bytes]) -> None:
        _check_answer(_answer(port, parts))
        assert _listens(port, b"/api/disarm"), "the next client is not received"

    return Parser(lambda random: _raw_request(random, b"/api/goal"), take, ())


def _stop() -> Parser:
    """Return the parser of the dedicated stop port: no client may prevent the next one's stop."""
    robot = _Robot()
    way = StopListener(Api(port=0), robot.inbox, robot.snapshot)
    port = way.start()

    def take(parts: list[bytes]) -> None:
        _check_answer(_answer(port, parts))
        assert _listens(port, b"/api/stop"), "the next stop is not done"

    return Parser(lambda random: _raw_request(random, b"/api/stop"), take, ())


PARSERS: dict[str, Callable[[], Parser]] = {
    "api.requests": _requests,
    "api.server": _server,
    "stop.listener": _stop,
}
