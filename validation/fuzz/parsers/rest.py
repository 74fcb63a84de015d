"""Requests of clients: to the REST API and to the dedicated stop port, as bytes in one or two pieces."""

import contextlib
import json
import logging
import socket
import threading
from collections.abc import Callable, Mapping
from random import Random
from typing import Any

from softarm.daemon.api.app import create_app
from softarm.daemon.api.context import ApiContext
from softarm.daemon.api.endpoints.policies import Policies
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
from validation.fuzz.parsers.base import Parser, parser

PATIENCE_S = 10.0
_ALLOWED = {101, 200, 400, 403, 404, 405, 408, 409, 411, 413, 415, 422, 426, 431, 503}
_METHODS = (b"GET", b"POST", b"PUT", b"DELETE", b"HEAD", b"OPTIONS", b"PATCH", b"", b"get")
_PATHS = (b"/api/goal", b"/api/policy", b"/api/arm", b"/api/stop", b"/api/status", b"/api/health", b"/docs", b"/")
_BODIES: tuple[Any, ...] = ({"kind": "reach", "y_m": -0.2, "z_m": 0.65}, {"kind": "hold"}, {"name": "hold"})
_HEADERS = (
    b"Origin: http://127.0.0.1",
    b"Authorization: Bearer 0123456789abcdef0123456789abcdef",
    b"Expect: 100-continue",
    b"Cookie: a=b",
)
_STREAM = (
    b"GET /api/stream?hz=5 HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n\x81\x85\1\2\3\4hello"
)


class _Policies(Policies):
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


def _draw(random: Random) -> list[bytes]:
    """Return a request as its bytes: wrong content in a sound request, or a wrong request."""
    body = mutate.to_json(random, mutate.of_tree(random, random.choice(_BODIES)))
    if random.random() < 0.05:
        body = b"[" * 4000
    is_sound = random.random() < 0.7
    method, path = (
        (b"POST", random.choice(_PATHS[:4])) if is_sound else (random.choice(_METHODS), random.choice(_PATHS))
    )
    lines = [b"%s %s HTTP/1.1" % (method, path), b"Host: 127.0.0.1", b"Content-Type: application/json"]
    lines += random.sample(_HEADERS, random.randrange(3))
    if random.random() < 0.5:
        lines.append(b"Content-Length: %d" % len(body))
    else:
        lines.append(b"Transfer-Encoding: chunked")
        body = b"%x\r\n%s\r\n0\r\n\r\n" % (len(body), body)
    data = b"\r\n".join([*lines, b"", body])
    if not is_sound:
        data = mutate.of_bytes(random, [data, _STREAM])
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


def _port(start: Callable[[], int], next_path: bytes) -> Parser:
    """Return the parser behind a port, where no client may prevent the request of the next one."""
    port = start()

    def take(parts: list[bytes]) -> None:
        answer = _answer(port, parts)
        head, _, body = answer.partition(b"\r\n\r\n")
        assert not answer or head.startswith(b"HTTP/1.1 "), f"said {answer[:80]!r}"
        assert not answer or int(head[9:12]) in _ALLOWED or 100 <= int(head[9:12]) < 400, f"said {answer[:200]!r}"
        if b"application/json" in head and int(head[9:12]) >= 400 and body.startswith(b"{"):
            said = json.JSONDecoder().raw_decode(body.decode())[0]
            assert "healthy" in said or (said["detail"] and said["reasons"])
        after = _answer(port, [b"POST %s HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n" % next_path])
        assert after.startswith(b"HTTP/1.1 200 "), f"the next client is answered {after[:80]!r}"

    return Parser(_draw, take, ())


@parser("api.server")
def _server() -> Parser:
    logging.getLogger("uvicorn").setLevel(logging.CRITICAL)
    robot = _Robot()
    context = ApiContext(Config(), robot.inbox, robot.snapshot, policies=_Policies(Config()), clock=robot.clock)
    return _port(ApiServer(Api(port=0), create_app(context)).start, b"/api/disarm")


@parser("stop.listener")
def _stop() -> Parser:
    robot = _Robot()
    return _port(StopListener(Api(port=0), robot.inbox, robot.snapshot).start, b"/api/stop")
