"""Log-in from a browser by a token and then a cookie that no script or other site can use."""

import itertools
import json
import re

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from softarm.daemon.access.auth import LOGIN_S, LOGINS_MAX, TICKET_S, Role, SecretStore, Sessions
from softarm.schemas.config import Api, Config
from tests.daemon.conftest import TOKENS

HOST = "robot.example"
PAGE = {"Origin": f"http://{HOST}"}


@pytest.fixture
def client(strict):
    return strict


def logged_in(client, key="token_file", **headers):
    """Return the headers of a page of this API in a logged-in browser."""
    answer = client.post("/api/login", json={"token": TOKENS[key]}, headers=PAGE | headers)
    assert answer.status_code == 200, answer.text
    return PAGE | {"Cookie": answer.headers["set-cookie"].partition(";")[0]}


def test_the_cookie_is_kept_from_scripts_other_sites_and_the_token(client):
    answer = client.post("/api/login", json={"token": TOKENS["view_token_file"]}, headers=PAGE)
    assert answer.json() == {"needed": True, "role": "view"}
    pair, *attributes = answer.headers["set-cookie"].split("; ")
    assert re.fullmatch(r"softarm-8080=[\w-]{43}", pair)
    assert attributes == ["Path=/", "Max-Age=43200", "HttpOnly", "SameSite=Strict"]
    assert TOKENS["view_token_file"] not in answer.headers["set-cookie"]


def test_a_logged_in_browser_needs_no_token_and_a_token_needs_no_page(client, loop):
    page = logged_in(client)
    assert client.get("/api/status", headers=page).status_code == 200
    assert client.get("/api/status", headers={"Cookie": "a=b; " + page["Cookie"] + " ;c"}).status_code == 200
    assert client.get("/api/login", headers=page).json() == {"needed": True, "role": "command"}
    assert client.post("/api/arm", headers=page).status_code == 200
    assert loop.taken[-1].request.who == "the dashboard (command token)"
    token = {"Authorization": f"Bearer {TOKENS['token_file']}"}  # needs no page
    assert client.post("/api/arm", headers=token).status_code == 200
    assert client.post("/api/arm", headers=page | {"Authorization": "Bearer wrong"}).status_code == 401


def test_without_a_login_the_answer_says_so(client):
    assert client.get("/api/login").json() == {"needed": True, "role": None}
    assert client.get("/api/status", headers={"Cookie": "softarm-8080=guess"}).status_code == 401
    token = {"Authorization": f"Bearer {TOKENS['stop_token_file']}"}
    assert client.get("/api/login", headers=token).json()["role"] == "stop"


def test_a_login_has_the_role_of_its_token(client):
    rights = {"token_file": (200, 200), "view_token_file": (403, 200), "stop_token_file": (403, 403)}
    for key, (arm, ticket) in rights.items():
        page = logged_in(client, key)
        may = {"/api/arm": arm, "/api/stop": 200, "/api/ticket": ticket, "/api/logout": 200}
        assert {path: client.post(path, headers=page).status_code for path in may} == may, key


FOREIGN = (None, "null", "http://evil.example", f"https://{HOST}", f"http://{HOST}:81", f"http://{HOST}.evil.example")


CHANGES = ("POST /api/arm", "POST /api/stop", "DELETE /api/goal", "PUT /api/policy")


def test_a_change_by_cookie_must_come_from_a_page_of_this_api(client, loop):
    page = logged_in(client)
    for asked, origin in itertools.product(CHANGES, FOREIGN):
        headers = page | {"Origin": origin}
        headers = {name: value for name, value in headers.items() if value is not None}
        answer = client.request(*asked.split(), headers=headers)
        assert answer.status_code == 403, (asked, origin)
        assert "allowed are pages of this API" in answer.json()["detail"]
        assert loop.taken == []
        assert client.get("/api/login", headers=page).json()["role"] == "command"


def test_another_site_cannot_log_a_browser_in(client):
    body = {"token": TOKENS["token_file"]}
    answer = client.post("/api/login", json=body, headers={"Origin": "http://evil.example"})
    assert (answer.status_code, "set-cookie" in answer.headers) == (403, False)
    assert client.post("/api/login", json=body).status_code == 200  # curl, which is no browser


INVALID = (
    ({"token": "wrong" * 8}, 401, "the token is wrong: enter the text in the file of api.token_file"),
    ({"token": "\ud800" * 20}, 401, "the token is wrong"),
    ({"token": ""}, 401, "the token is wrong"),
    ({}, 422, "token: missing; must be text: the token in the file of api.token_file"),
    ({"token": 5}, 422, "token: must be text"),
    ([], 422, "the body must be a JSON object"),
)


def test_an_invalid_token_is_refused_with_the_next_step_and_never_repeated(client):
    kind = {"Content-Type": "application/json"}
    for body, status, sentence in INVALID:
        answer = client.post("/api/login", content=json.dumps(body), headers=PAGE | kind)
        assert (answer.status_code, answer.json()["detail"][: len(sentence)]) == (status, sentence)
        assert "set-cookie" not in answer.headers
    answer = client.post("/api/login", json={"tokens": TOKENS["token_file"]}, headers=PAGE)
    assert TOKENS["token_file"] not in answer.text


def test_wrong_tokens_are_logged_a_limited_number_of_times(client, caplog):
    for _ in range(9):
        client.post("/api/login", json={"token": "wrong" * 8}, headers=PAGE)
    assert [record.args[0] for record in caplog.records if "wrong token" in record.msg] == [1, 2, 4, 8]
    assert "wrongwrong" not in caplog.text


def test_a_new_login_or_logging_out_ends_the_old_one(client):
    page = logged_in(client, "view_token_file")
    again = logged_in(client, **page)
    assert client.get("/api/status", headers=page).status_code == 401
    assert client.get("/api/login", headers=again).json()["role"] == "command"
    answer = client.post("/api/logout", headers=again)
    assert answer.json() == {"needed": True, "role": None}
    assert answer.headers["set-cookie"].startswith("softarm-8080=; Path=/; Max-Age=0;")
    assert client.get("/api/status", headers=again).status_code == 401


def test_without_tokens_no_login_is_needed(loop, app, client_of):
    client = client_of(app(loop))
    assert client.get("/api/login").json() == {"needed": False, "role": "command"}
    answer = client.post("/api/login", json={"token": "c" * 32})
    assert answer.status_code == 409
    assert answer.json()["detail"] == "this API requires no token, so there is no log-in"


def test_a_ticket_opens_one_stream_and_the_cookie_none(loop, app, client_of, serving, roles):
    config = Config(api={"port": 0} | roles)
    made = app(loop, config)
    client = client_of(made, "http://127.0.0.1")
    answer = client.post("/api/login", json={"token": TOKENS["view_token_file"]})
    page = {"Origin": "http://127.0.0.1", "Cookie": answer.headers["set-cookie"].partition(";")[0]}
    with serving(made, config.api) as port:
        address = f"ws://127.0.0.1:{port}/api/stream"
        ticket = client.post("/api/ticket", headers=page).json()
        assert ticket["seconds"] == TICKET_S
        with connect(f"{address}?hz=5&ticket={ticket['ticket']}") as socket:
            assert json.loads(socket.recv(timeout=5))["mode"] == "armed"
        for query, headers in ((f"?ticket={ticket['ticket']}", {}), ("?ticket=", {}), ("", {"Cookie": page["Cookie"]})):
            with pytest.raises(InvalidStatus) as refusal:
                connect(address + query, additional_headers=headers)
            assert refusal.value.response.status_code == 401
    assert client.get("/api/status", headers={"Cookie": f"softarm-0={ticket['ticket']}"}).status_code == 401


PUBLIC = "https://arm.example"


def test_behind_a_tls_proxy_the_cookie_is_secure_and_its_pages_are_allowed(loop, app, client_of, roles):
    config = Config(api={"public_origin": PUBLIC} | roles)
    for host in ("127.0.0.1:8080", "arm.example"):  # as proxies may name it
        client = client_of(app(loop, config), f"http://{host}")
        answer = client.post("/api/login", json={"token": TOKENS["token_file"]}, headers={"Origin": PUBLIC})
        assert answer.headers["set-cookie"].endswith("; SameSite=Strict; Secure")
        cookie = {"Cookie": answer.headers["set-cookie"].partition(";")[0]}
        assert client.post("/api/arm", headers=cookie | {"Origin": PUBLIC}).status_code == 200
        for other in ("http://arm.example:81", "https://arm.example:444", "https://evil.example"):
            assert client.post("/api/arm", headers=cookie | {"Origin": other}).status_code == 403
    stranger = client_of(app(loop, config), "http://evil.example")
    assert stranger.get("/api/status", headers=cookie).status_code == 403


@pytest.mark.parametrize(
    "origin", ["arm.example", "http://{}", "https://{}/", "https://Arm.example", "https://{}:443", "https://"]
)
def test_a_public_origin_must_have_the_form_that_browsers_send(roles, origin):
    with pytest.raises(ValueError, match=r"allowed https://HOST or https://HOST:PORT as a browser shows it"):
        Api(public_origin=origin.format("arm.example"), **roles)


def test_a_public_origin_needs_a_token():
    with pytest.raises(ValueError, match="public_origin without token_file: every client of the proxy may command"):
        Api(public_origin=PUBLIC)


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_secrets_expire_and_are_limited_in_number():
    clock = Clock()
    handed = SecretStore(10.0, 3, clock)
    first = handed.issue(Role.VIEW)
    clock.now = 9.9
    assert handed.role(first) is Role.VIEW
    clock.now = 10.0
    assert handed.role(first) is None
    many = [handed.issue(Role.STOP) for _ in range(4)]
    assert len(set(many)) == 4
    assert [handed.role(each) for each in many] == [None, *[Role.STOP] * 3]
    assert (handed.revoke(many[1]), handed.revoke(many[1])) == (Role.STOP, None)


def test_a_login_lasts_half_a_day_and_a_ticket_seconds():
    clock = Clock()
    sessions = Sessions(8080, clock)
    login, ticket = sessions.logins.issue(Role.VIEW), sessions.tickets.issue(Role.VIEW)
    clock.now = TICKET_S
    assert (sessions.logins.role(login), sessions.tickets.role(ticket)) == (Role.VIEW, None)
    clock.now = LOGIN_S
    assert sessions.logins.role(login) is Role.STOP  # a stop button on a page left open works on
    others = [sessions.logins.issue(Role.VIEW) for _ in range(LOGINS_MAX)]
    assert {sessions.logins.role(each) for each in others} == {Role.VIEW}
    assert sessions.logins.role(login) is None
