"""Access control by host, page and token."""

import json

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect as connect_sync

from softarm.daemon.access.auth import AccessControl, AuthError, Role, load_tokens
from softarm.schemas.config import Api, Config
from tests.daemon.conftest import TOKENS

TOKEN = TOKENS["token_file"]


def headers(origin, host="127.0.0.1:8081"):
    return {b"origin": origin.encode(), b"host": host.encode()}


@pytest.mark.parametrize("role", [None, Role.COMMAND])
def test_loopback_refuses_foreign_hosts_and_pages(role):
    access = AccessControl(Api())
    for host in ("localhost:8080", "[::1]:8080", "127.0.0.1"):
        assert access.refusal(headers("", host), role) is None
        assert access.refusal(headers(f"http://{host}", host), role) is None
    refused = access.refusal(headers("", "robot.example:8080"), role)
    assert refused == (403, "the Host header is 'robot.example:8080'; ask for this machine as 127.0.0.1 or localhost")
    for origin in ("https://evil.example", "null", "http://[::1", "http://[", "//[x]:y"):  # null: a sandboxed report
        refused = access.refusal(headers(origin), role)
        assert refused == (403, f"a page of {origin!r} may not command this robot; use the daemon's own pages")


def test_the_api_refuses_foreign_pages(client, loop):
    for method, path in (("POST", "/api/arm"), ("GET", "/api/status"), ("GET", "/")):
        assert client.request(method, path, headers={"Origin": "https://evil.example"}).status_code == 403
    assert loop.taken == []
    assert client.post("/api/arm", headers={"Origin": "http://127.0.0.1"}).status_code == 200


NEAR = ["http://127.0.0.1:8080", "http://localhost:8080", "http://[::1]:8080"]
ELSEWHERE = (
    "http://127.0.0.1:8079 https://127.0.0.1:8080 http://evil.example:8080 http://127.0.0.1:8080.evil.example null "
    "http://evil@127.0.0.1:8080 http://127.0.0.1:8080/ http://127.0.0.1:99999 http://127.0.0.1: http://[::1"
)
FAR = "http://robot.example:8080"


def test_only_pages_of_the_api_may_use_the_stop_port(roles):
    access, far = AccessControl(Api()), AccessControl(Api(host="0.0.0.0", **roles))
    assert [access.own_page(headers(origin), 8080) for origin in NEAR] == NEAR
    for origin in ("", *ELSEWHERE.split()):
        assert access.own_page(headers(origin), 8080) is None, origin
    for origin in (NEAR[0], "http://evil.example:8080"):
        assert access.own_page(headers(origin, "evil.example:8081"), 8080) is None
    assert far.own_page(headers(FAR, "robot.example:8081"), 8080) == FAR
    for origin in ("", "null", "http://evil.example:8080", "http://robot.example:8081", "https://robot.example:8080"):
        assert far.own_page(headers(origin, "robot.example:8081"), 8080) is None, origin
    assert far.own_page(headers(FAR, "evil.example:8081"), 8080) is None


def test_loopback_refuses_foreign_pages_on_the_stream_too(plain, serving):
    with serving(plain) as port, pytest.raises(InvalidStatus) as refusal:
        connect_sync(f"ws://127.0.0.1:{port}/api/stream", origin="https://evil.example")
    assert refusal.value.response.status_code == 403
    assert b"may not command this robot" in refusal.value.response.body


def test_another_address_requires_a_token(loop, app):
    with pytest.raises(AuthError, match=r"api\.host 0\.0\.0\.0 .* needs api\.token_file: write a long random"):
        app(loop, Config(api={"host": "0.0.0.0"}))


@pytest.mark.parametrize(
    ("text", "mode", "sentence"),
    [
        ("short", 0o600, "holds 5 characters; allowed: one word, 16 or more"),
        ("two words that are long enough", 0o600, "one word"),
        (TOKEN, 0o604, "every user of this machine can open it; `chmod o= "),
        ("ü" * 20, 0o600, "cannot be read"),
    ],
)
def test_a_bad_token_file_is_refused(tmp_path, tokens, text, mode, sentence):
    files = tokens(token_file=text)
    files["token_file"].chmod(mode)
    with pytest.raises(AuthError) as refusal:
        load_tokens(Api(host="0.0.0.0", **files))
    assert sentence in str(refusal.value)
    with pytest.raises(AuthError, match="cannot be read"):
        load_tokens(Api(token_file=tmp_path / "missing"))


def test_with_a_token_every_request_needs_it(loop, tokens, app, client_of):
    config = Config(api={"host": "0.0.0.0"} | tokens(token_file=TOKEN + "\n"))
    client = client_of(app(loop, config), "http://robot.example")
    for path in ("/api/status", "/docs", "/openapi.json", "/nothing"):
        answer = client.get(path)
        assert answer.status_code == 401
        assert "`Authorization: Bearer TOKEN`" in answer.json()["detail"]
    wrong = client.get("/api/status", headers={"Authorization": f"Bearer {TOKEN}x"})
    assert (wrong.status_code, wrong.json()["detail"][:18]) == (401, "the token is wrong")
    assert client.get("/api/status", headers={"Authorization": TOKEN}).status_code == 401
    right = {"Authorization": f"Bearer {TOKEN}"}
    assert client.get("/api/status", headers=right).status_code == 200


NAMES = {"stop_token_file": "stop", "view_token_file": "view", "token_file": "command"}
MAY = {  # the least of them that may
    ("GET", "/api/status"): "view_token_file",
    ("HEAD", "/api/status"): "view_token_file",
    ("GET", "/api/logs"): "view_token_file",
    ("GET", "/openapi.json"): "view_token_file",
    ("GET", "/api/stop"): "view_token_file",
    ("POST", "/api/stop"): "stop_token_file",
    ("PUT", "/api/stop"): "token_file",
    ("POST", "/api/stop/"): "token_file",
    ("POST", "/api/arm"): "token_file",
    ("DELETE", "/api/goal"): "token_file",
    ("PUT", "/api/policy"): "token_file",
    ("DELETE", "/api/logs/flight.mcap"): "token_file",
    ("POST", "/api/jobs"): "token_file",
    ("OPTIONS", "/api/status"): "token_file",
    ("BREW", "/api/status"): "token_file",
}


def test_each_role_includes_the_lower_ones_only(loop, strict):
    rising = list(NAMES)
    for key in rising:
        loop.taken.clear()
        for asked, least in MAY.items():
            answer = strict.request(*asked, headers={"Authorization": f"Bearer {TOKENS[key]}"})
            allowed = rising.index(key) >= rising.index(least)
            assert (answer.status_code not in (401, 403)) is allowed, (key, asked)
            if not allowed and asked[0] != "HEAD":
                assert f"use the token of api.{least}" in answer.json()["detail"], (key, asked)
        assert {post.request.who for post in loop.taken} == {f"the API ({NAMES[key]} token)"}


def test_the_stream_needs_the_view_role(loop, roles, app, serving):
    config = Config(api={"port": 0} | roles)
    with serving(app(loop, config), config.api) as port:
        address = f"ws://127.0.0.1:{port}/api/stream"
        with connect_sync(address, additional_headers={"Authorization": f"Bearer {'v' * 32}"}) as socket:
            assert json.loads(socket.recv(timeout=5))["mode"] == "armed"
        for headers, status in (({}, 401), ({"Authorization": f"Bearer {'s' * 32}"}, 403)):
            with pytest.raises(InvalidStatus) as refusal:
                connect_sync(address, additional_headers=headers)
            assert refusal.value.response.status_code == status


def test_roles_need_a_command_token_and_different_tokens(tokens, roles):
    assert load_tokens(Api(**roles)) == {Role.COMMAND: TOKEN, Role.VIEW: "v" * 32, Role.STOP: "s" * 32}
    with pytest.raises(ValueError, match="view_token_file without token_file: any client may command"):
        Api(view_token_file=roles["view_token_file"])
    with pytest.raises(AuthError, match=r"holds the token of api\.token_file, which may do more") as refusal:
        load_tokens(Api(token_file=roles["token_file"], **tokens(stop_token_file=TOKEN)))
    assert refusal.value.key == "stop_token_file"


def test_a_client_on_another_machine_is_named_by_its_address(roles):
    access = AccessControl(Api(host="0.0.0.0", **roles))
    headers = {b"authorization": b"Bearer " + b"v" * 32}
    assert access.who("the API", headers, "10.0.0.7") == "the API (view token, 10.0.0.7)"
    assert access.who("the API", {b"authorization": b"Bearer wrong"}, "10.0.0.7") == "the API (10.0.0.7)"
    for own in ("127.0.0.1", "::1", None):
        assert access.who("the API", {}, own) == "the API"


PROXIED = {b"host": b"arm.example", b"x-forwarded-for": b"203.0.113.9, 192.0.2.7"}


@pytest.mark.parametrize(
    ("headers", "address", "details"),
    [
        ({}, "127.0.0.1", ", 192.0.2.7"),  # the last: the proxy's own word
        ({b"host": b"127.0.0.1:8080", b"origin": b"https://arm.example"}, "::1", ", 192.0.2.7"),
        ({b"x-forwarded-for": b"2001:db8::1"}, "127.0.0.1", ", 2001:db8::1"),
        ({b"x-forwarded-for": b"127.0.0.1"}, "127.0.0.1", ""),
        ({b"x-forwarded-for": b"192.0.2.7, the moon"}, "127.0.0.1", ""),
        ({b"x-forwarded-for": b"192.0.2.7,"}, "127.0.0.1", ""),
        ({b"x-forwarded-for": b""}, "127.0.0.1", ""),
        ({b"host": b"127.0.0.1:8080"}, "127.0.0.1", ""),  # a program here, not the proxy
        ({b"host": b"127.0.0.1:8080", b"origin": b"http://arm.example"}, "127.0.0.1", ""),
        ({}, "198.51.100.4", ", 198.51.100.4"),  # another machine that says so
        ({}, None, ""),
    ],
)
def test_only_the_proxy_may_name_the_clients_address(tokens, headers, address, details):
    access = AccessControl(Api(public_origin="https://arm.example", **tokens(token_file=TOKEN)))
    assert access.who("the API", PROXIED | headers, address, Role.VIEW) == f"the API (view token{details})"


def test_without_a_proxy_the_forwarded_address_is_ignored():
    assert AccessControl(Api()).who("the API", PROXIED, "127.0.0.1") == "the API"
