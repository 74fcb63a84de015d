"""Bounds on untrusted clients in size, keys, connections and time; a stop is always accepted."""

import asyncio
import json
import socket
import time
from contextlib import ExitStack
from dataclasses import replace

import httpx
import pytest

from softarm.daemon.control.records import EStop, Mode

LOCAL = "http://127.0.0.1"
JSON = {"Content-Type": "application/json"}


def keys(count: int) -> str:
    return json.dumps({"kind": "hold"} | {f"key{i}": i for i in range(count)})


async def pieces():
    """Yield a body without a stated length."""
    for _ in range(1000):
        yield b" " * 1000


@pytest.mark.parametrize("body", [keys(100_000), "{" * 5000, pieces()], ids=["100,000 keys", "no JSON", "no length"])
def test_a_body_that_is_too_long_is_not_parsed(client, loop, body):
    answer = client.post("/api/goal", content=body, headers=JSON)
    assert answer.status_code == 413  # parsed, it would be 422 or 400
    assert answer.json()["detail"].startswith("the body has more than 4096 bytes")
    assert not loop.taken


def test_the_first_of_many_mistakes_are_reported_without_long_names(client):
    reasons = client.post("/api/goal", content=keys(100), headers=JSON).json()["reasons"]
    assert len(reasons) == 6
    assert reasons[0].startswith("key0: unknown key")
    assert reasons[-1] == "and 95 more errors"
    reason = client.post("/api/goal", json={"kind": "hold", "x" * 3000: 1}).json()["reasons"][0]
    assert reason.startswith("x" * 40 + "...: unknown key")


@pytest.mark.parametrize("body", [b"[" * 4000, b'{"kind": "\xff"}'])
def test_an_unreadable_body_is_refused_with_the_reason(client, body):
    answer = client.post("/api/goal", content=body, headers=JSON)
    assert answer.status_code == 400
    assert answer.json()["reasons"] == [answer.json()["detail"]]
    assert "UTF-8 without deep nesting" in answer.json()["detail"]


@pytest.mark.parametrize("path", ["/api/stop", "/api/arm"])
def test_a_request_done_while_the_api_was_delayed_is_confirmed(stalled, app, client_of, monkeypatch, path):
    monkeypatch.setattr("softarm.daemon.api.requests.ANSWER_S", 0.02)

    def late_look():
        seen = stalled.outputs
        stalled.tick()
        time.sleep(0.05)
        return seen

    assert client_of(app(stalled, snapshot=late_look)).post(path).status_code == 200


def test_a_later_tick_with_the_stop_confirms_it_without_its_result(silent):
    client, loop = silent
    stopped = replace(loop.outputs, mode=Mode.STOPPED, estop=EStop.LATCHED, results=())
    loop.outputs = replace(stopped, t_ns=time.monotonic_ns() + 10**9)
    assert client.post("/api/stop").status_code == 200
    loop.outputs = replace(stopped, t_ns=time.monotonic_ns() - 1)
    assert client.post("/api/stop").status_code == 503  # an earlier stop's


@pytest.mark.parametrize("length", [100, 5_000_000])
def test_a_stop_does_not_wait_for_a_body(loop, plain, serving, length):
    with serving(plain) as port, ExitStack() as stack:
        request = b"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: %d\r\n\r\nx" % length
        assert opened(stack, port, request).recv(100).startswith(b"HTTP/1.1 200 ")
    assert [post.request.kind for post in loop.taken] == ["stop"]


@pytest.mark.parametrize(("path", "kinds"), [("/api/arm", []), ("/api/stop", ["stop"])])
def test_only_a_stop_is_carried_out_for_a_client_that_left_within_its_body(plain, loop, path, kinds):
    scope = {"type": "http", "method": "POST", "path": path, "query_string": b"", "headers": [(b"host", b"127.0.0.1")]}
    left = iter([{"type": "http.request", "body": b"{", "more_body": True}])

    async def receive():
        return next(left, {"type": "http.disconnect"})

    async def send(message):
        pass

    asyncio.run(plain(scope, receive, send))
    assert [post.request.kind for post in loop.taken] == kinds


def opened(stack: ExitStack, port: int, sent: bytes = b"") -> socket.socket:
    connection = stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5))
    connection.sendall(sent)
    return connection


@pytest.mark.slow
@pytest.mark.parametrize(
    "sent", [b"", b"POST /api/goal HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 4000\r\n\r\n{"], ids=["idle", "slow"]
)
def test_idle_clients_make_room_for_new_ones(plain, serving, sent):
    with serving(plain) as port, ExitStack() as stack:
        idle = [opened(stack, port, sent) for _ in range(160)]
        assert httpx.post(f"{LOCAL}:{port}/api/stop", timeout=5).status_code == 200
        gone = sum(is_closed(one) for one in idle)
        assert 160 - 128 <= gone <= 160 - 126  # the oldest gave way, no more


def is_closed(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True


def said_until_closed(connection: socket.socket, trickle: bytes = b"") -> bytes:
    """Return the server's whole answer while single bytes are sent."""
    said = b""
    connection.settimeout(0.05)
    while True:
        try:
            part = connection.recv(65536)
        except TimeoutError:
            try:
                connection.sendall(trickle)
            except (BrokenPipeError, ConnectionResetError):
                return said
        except ConnectionResetError:
            return said
        else:
            if not part:
                return said
            said += part


@pytest.mark.parametrize(
    ("sent", "trickle"),
    [
        (b"", b""),
        (b"GET /api/status HTTP/1.1\r\nX-Slow: ", b"x"),
        (b"GET /nothing HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET ", b"x"),
    ],
    ids=["nothing said", "a slow header", "a slow second header"],
)
def test_a_client_without_a_request_is_disconnected(plain, serving, monkeypatch, sent, trickle):
    monkeypatch.setattr("softarm.daemon.api.bounds.QUIET_S", 0.3)
    with serving(plain) as port, ExitStack() as stack:
        said_until_closed(opened(stack, port, sent), trickle)  # ends


def test_a_slow_body_is_refused_and_its_connection_closed(plain, serving, monkeypatch):
    monkeypatch.setattr("softarm.daemon.api.bounds.BODY_S", 0.3)
    with serving(plain) as port, ExitStack() as stack:
        request = b"POST /api/goal HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 4000\r\n\r\n"
        said = said_until_closed(opened(stack, port, request), b" ")
        assert said.startswith(b"HTTP/1.1 408 ")
        assert b"did not arrive within 0.3 s" in said


def test_a_header_that_is_too_long_is_refused(plain, serving):
    with serving(plain) as port, ExitStack() as stack:
        said = said_until_closed(opened(stack, port, b"GET / HTTP/1.1\r\nX: " + b"x" * 100_000))
        assert said.startswith(b"HTTP/1.1 400 ") or not said


def test_an_invalid_body_that_cannot_be_answered_closes_the_connection(plain, serving, caplog):
    head = b"HEAD /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n"
    with serving(plain) as port, ExitStack() as stack:
        said = said_until_closed(opened(stack, port, head + b"2\r\n{}]]\r\n"), b"]")
    assert said.count(b"HTTP/1.1 ") <= 1
    assert [record for record in caplog.records if record.name == "asyncio"] == []
