"""Dedicated stop port: access, answers and independence from slow clients."""

import http.client
import json
import socket
import threading
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace

import pytest

from softarm.daemon.access.auth import AuthError, Role, Sessions
from softarm.daemon.access.sockets import ApiError
from softarm.daemon.control.records import EStop, Mode
from softarm.daemon.stop import listener
from softarm.daemon.stop.listener import StopListener
from softarm.schemas.config import Api

TOKEN = "0123456789abcdef0123456789abcdef"
GOOD = b"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


def senders(loop) -> list[str]:
    """Return the senders of the stops that the loop has carried out; nothing else was requested."""
    assert {post.request.kind for post in loop.taken} <= {"stop"}
    return [post.request.who for post in loop.taken]


@contextmanager
def way(loop, config: Api | None = None, sessions: Sessions | None = None):
    others = set(threading.enumerate())  # another test's daemon may still be stopping
    made = StopListener(config or Api(port=0), loop.inbox, lambda: loop.outputs, sessions=sessions)
    port = made.start()
    try:
        yield port
    finally:
        made.stop()
        assert not any(thread.name == "stop" for thread in set(threading.enumerate()) - others)


def send(port: int, method: str, path: str, headers: dict[str, str]) -> tuple[http.client.HTTPResponse, bytes]:
    """Return the answer to a request and its body."""
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=5)) as connection:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer, answer.read()


def ask(port: int, method: str = "POST", path: str = "/api/stop", **headers: str) -> tuple[int, dict]:
    answer, body = send(port, method, path, headers)
    return answer.status, json.loads(body)


def test_a_stop_is_answered_once_a_tick_confirms_it(stalled):
    stalled.outputs = replace(stalled.outputs, mode=Mode.STOPPED, estop=EStop.LATCHED)
    with stalled.running(), way(stalled) as port:
        answer, body = send(port, "POST", "/api/stop", {"softarm-api": "7"})  # any version may stop
    assert (answer.status, answer.getheader("softarm-api")) == (200, "1")
    said = json.loads(body)
    assert (said["stopped"], said["mode"], said["estop"]) == (True, "stopped", "latched")
    assert senders(stalled) == ["the dedicated stop port"]


def test_a_hung_loop_is_reported_and_the_stop_stays_in_the_inbox(stalled):
    with way(stalled) as port:
        status, said = ask(port)
    assert status == 503
    assert said["reasons"][0] == "stop: the control loop did not answer within 0.5 s"
    assert "use the emergency-stop button" in said["detail"]
    assert [post.request.kind for post in stalled.inbox.take()] == ["stop"]


def test_other_requests_are_refused(loop):
    with way(loop) as port:
        code, said = ask(port, path="/api/arm")
        assert (code, said["reasons"]) == (404, [said["detail"]])
        assert "this port accepts POST /api/stop only" in said["detail"]
        assert ask(port, method="GET")[0] == 404
    assert loop.taken == []


def test_a_stop_needs_a_token_if_one_is_configured(loop, tokens):
    with way(loop, Api(port=0, **tokens(token_file=TOKEN))) as port:
        assert ask(port)[0] == 401
        assert ask(port, Authorization=f"Bearer {TOKEN}x")[0] == 401
        assert loop.taken == []
        assert ask(port, Authorization=f"Bearer {TOKEN}")[0] == 200
    with pytest.raises(AuthError):
        StopListener(Api(host="0.0.0.0"), loop.inbox, lambda: loop.outputs)


PAGES = Api(port=8080, stop_port=0)  # as if the API served at 8080
NAMED = "http://robot.example:8080"
PAGE = {"Origin": NAMED, "Host": "robot.example:8081"}


@pytest.fixture
def far(tokens):
    """Return settings of an API that other computers can reach."""
    return Api(host="0.0.0.0", port=8080, stop_port=0, **tokens(token_file=TOKEN))


def fetch(port: int, method: str, **headers: str) -> tuple[int, dict[str, str]]:
    """Return the status and the allowed origin that a browser receives."""
    answer, _ = send(port, method, "/api/stop", headers)
    return answer.status, {name: value for name, value in answer.getheaders() if name.startswith("Access-Control")}


def allowed_to(origin: str) -> dict[str, str]:
    return {"Access-Control-Allow-Origin": origin, "Access-Control-Allow-Credentials": "true"}


def test_a_page_of_the_api_may_use_the_stop_port(loop):
    origin = "http://127.0.0.1:8080"
    with way(loop, PAGES) as port:
        status, allowed = fetch(port, "OPTIONS", Origin=origin, **{"Access-Control-Request-Method": "POST"})
        assert status == 204
        assert allowed["Access-Control-Allow-Origin"] == origin
        assert allowed["Access-Control-Allow-Methods"] == "POST"
        assert "Authorization" in allowed["Access-Control-Allow-Headers"]
        assert loop.taken == []
        assert fetch(port, "POST", Origin=origin) == (200, allowed_to(origin))
    assert len(senders(loop)) == 1


def test_other_pages_are_refused(loop):
    with way(loop, PAGES) as port:
        for method in ("OPTIONS", "POST"):
            assert fetch(port, method, Origin="http://evil.example:8080") == (403, {})
        assert fetch(port, "OPTIONS") == (404, {})
    assert loop.taken == []


def test_beyond_loopback_a_page_of_the_api_needs_a_token(loop, far):
    with way(loop, far) as port:
        assert fetch(port, "OPTIONS", **PAGE)[0] == 204
        assert fetch(port, "POST", **PAGE) == (401, allowed_to(NAMED))
        assert fetch(port, "POST", **PAGE, Authorization=f"Bearer {TOKEN}")[0] == 200
        assert fetch(port, "OPTIONS", **PAGE | {"Origin": "http://other.example:8080"})[0] == 401
    assert len(senders(loop)) == 1


@pytest.fixture
def sessions():
    return Sessions(8080)


def cookie(sessions) -> str:
    return sessions.cookie(sessions.logins.issue(Role.STOP), secure=False).partition(";")[0]


def test_a_page_that_has_logged_in_stops_without_a_token(loop, far, sessions):
    with way(loop, far, sessions) as port:
        assert fetch(port, "POST", Cookie=f"other=1; {cookie(sessions)}", **PAGE) == (200, allowed_to(NAMED))
    assert senders(loop) == ["the dedicated stop port (stop token)"]


def test_the_cookie_is_ignored_from_other_pages(loop, far, sessions):
    with way(loop, far, sessions) as port:
        for page in ({}, {"Origin": "http://evil.example:8080"}):
            headers = {"Host": PAGE["Host"], "Cookie": cookie(sessions)} | page
            assert fetch(port, "POST", **headers) == (401, {})
    assert loop.taken == []


def test_a_foreign_or_invented_cookie_is_ignored(loop, far, sessions):
    secret = sessions.logins.issue(Role.COMMAND)
    ticket = sessions.tickets.issue(Role.COMMAND)
    with way(loop, far, sessions) as port:
        for value in (f"softarm-8090={secret}", "softarm-8080=guess", "softarm-8080=", f"softarm-8080={ticket}", ""):
            assert fetch(port, "POST", Cookie=value, **PAGE)[0] == 401
        both = {"Cookie": f"softarm-8080={secret}", "Authorization": "Bearer wrong"}
        assert fetch(port, "POST", **both, **PAGE)[0] == 401  # a token in the header takes precedence
    assert loop.taken == []


@pytest.mark.parametrize(
    "sent",
    [
        b"\r\n\r\n",
        b"\x00" * 5000 + b"\r\n\r\n",
        b"POST /api/stop\r\n\r\n",
        b"POST  /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET /api/stop HTTP/1.1\r\n:\r\nHost\r\n\r\n",
        b"x" * 20_000,
        b"\xff\xfe: \xff\r\n\r\n",
    ],
)
def test_a_malformed_request_is_refused(loop, sent):
    with way(loop) as port, socket.create_connection(("127.0.0.1", port), timeout=5) as client:
        client.sendall(sent)
        assert client.recv(100).startswith(b"HTTP/1.1 4")
        assert loop.taken == []
        assert ask(port)[0] == 200


def test_an_unexpected_error_closes_one_client_only(loop, monkeypatch, caplog):
    monkeypatch.setattr(listener.AccessControl, "refusal", lambda self, headers: headers[b"x-needed"])
    with way(loop) as port:
        with pytest.raises(http.client.RemoteDisconnected):
            ask(port)
        assert "closed a connection" in caplog.text
        monkeypatch.undo()
        assert ask(port)[0] == 200


WITH_A_BODY = GOOD.replace(b"\r\n\r\n", b"\r\nContent-Length: 100000\r\n\r\n") + b"x" * 100_000


@pytest.mark.parametrize("pieces", [[WITH_A_BODY], [bytes([byte]) for byte in GOOD]], ids=["with a body", "in pieces"])
def test_a_stop_with_a_body_or_in_pieces_is_answered(loop, pieces):
    with way(loop) as port, socket.create_connection(("127.0.0.1", port), timeout=5) as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for piece in pieces:
            client.sendall(piece)
        assert client.recv(100).startswith(b"HTTP/1.1 200 OK")
    assert len(senders(loop)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("sent", [b"", b"POST /api/st"])
def test_silent_clients_make_room_for_new_ones(loop, sent):
    with way(loop) as port, ExitStack() as stack:
        for _ in range(listener.CLIENTS_MAX + 36):
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5)).sendall(sent)
        assert ask(port)[0] == 200


def test_a_silent_client_is_closed(loop, monkeypatch):
    monkeypatch.setattr(listener, "CLIENT_TIMEOUT_S", 0.2)
    with way(loop) as port, socket.create_connection(("127.0.0.1", port), timeout=5) as client:
        assert client.recv(1) == b""


def test_many_simultaneous_stops_are_all_answered(stalled):
    with way(stalled) as port, ExitStack() as stack:
        clients = [stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5)) for _ in range(50)]
        for client in clients:
            client.sendall(GOOD)
        with stalled.running():
            assert all(client.recv(100).startswith(b"HTTP/1.1 200 OK") for client in clients)


def test_the_listener_survives_running_out_of_descriptors(loop, monkeypatch):
    """The oldest client is closed; the kernel's error is simulated."""
    real, refused = socket.socket.accept, []

    def accept(self):
        if len(refused) < 3:
            refused.append(True)
            raise OSError(24, "Too many open files")
        return real(self)

    monkeypatch.setattr(socket.socket, "accept", accept)
    with way(loop) as port:
        assert ask(port)[0] == 200
    assert len(refused) == 3


def test_a_port_that_is_taken_is_refused_with_its_key(loop):
    with way(loop) as port, pytest.raises(ApiError, match=rf"api\.stop_port {port}: cannot listen there"):
        StopListener(Api(stop_port=port), loop.inbox, lambda: loop.outputs).start()


@pytest.mark.parametrize(("port", "stop_port", "expected"), [(8080, None, 8081), (0, None, 0), (8080, 9, 9), (5, 0, 0)])
def test_the_stop_port_follows_the_apis_unless_configured(port, stop_port, expected):
    assert Api(port=port, stop_port=stop_port).stops_at == expected


@pytest.mark.parametrize(("port", "stop_port"), [(65535, None), (8080, 8080)])
def test_a_stop_port_that_is_no_port_or_the_apis_is_refused(port, stop_port):
    with pytest.raises(ValueError, match="choose another"):
        Api(port=port, stop_port=stop_port)
