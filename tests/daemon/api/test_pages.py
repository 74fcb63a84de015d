"""The dashboard's files: everybody who may come in is given them, and nothing else; a page may do what it has to."""

import re
from importlib import resources

import pytest

from softarm.daemon.api.endpoints.pages import POLICY, TYPES, Pages, stop_source
from softarm.daemon.api.refusals import Refused
from softarm.schemas.config import Config

FILES = resources.files("softarm.daemon.dashboard")
PAGE = FILES.joinpath("index.html").read_text(encoding="utf-8")
ASKED = re.findall(r'(?:src|href)="(/dashboard/[^"]+)"', PAGE)
SCRIPT = next(path for path in ASKED if path.endswith("js"))


@pytest.fixture
def strict(loop, app, client_of, tmp_path):
    """A client of an API that asks for a token."""
    (tmp_path / "token").write_text("c" * 32)
    (tmp_path / "token").chmod(0o600)
    return client_of(app(loop, Config(api={"host": "0.0.0.0", "token_file": tmp_path / "token"})), "http://arm.example")


def test_the_page_is_there_for_who_has_no_token_and_the_robot_is_not(strict):
    answer = strict.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert answer.text == PAGE
    assert strict.get("/api/status").status_code == 401


def test_all_that_the_page_asks_for_is_there(client):
    for path in ASKED:
        answer = client.get(path)
        assert answer.status_code == 200
        assert answer.headers["content-type"] == TYPES[path.rpartition(".")[2]]


def test_pages_of_other_sites_get_nothing(client):
    assert client.get("/", headers={"Host": "evil.example"}).status_code == 403
    assert client.get(SCRIPT, headers={"Origin": "http://evil.example"}).status_code == 403


@pytest.mark.parametrize(
    "path",
    [
        "/dashboard/",
        "/dashboard/__init__.py",
        "/dashboard/nothing.js",
        "/dashboard/../tick.py",
        "/dashboard/%2e%2e/%2e%2e/softarm.yaml",
        "/dashboard//etc/passwd",
        "/dashboard/..%2f..%2fapi%2fauth.py",
        "/dashboard/app.js%00.html",
        "/dashboard/vendor",
    ],
)
def test_nothing_else_is(strict, path):
    answer = strict.get(path)
    assert answer.status_code in (401, 404)  # 401: the client itself has made it another path
    assert set(answer.json()) == {"detail", "reasons"}


def test_a_path_to_the_api_through_the_dashboard_ends_in_the_dashboard(strict):
    answer = strict.get("/dashboard/%2e%2e/api/status")
    assert answer.status_code == 404
    assert answer.json()["detail"].startswith("the dashboard has no file")


def test_a_page_may_do_no_more_than_it_has_to(loop, app, client_of):
    client = client_of(app(loop, stop_port=lambda: 8081), "http://127.0.0.1:8080")
    for path in ("/", SCRIPT):
        headers = client.get(path).headers
        assert headers["content-security-policy"] == (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
            "manifest-src 'self'; connect-src 'self' http://127.0.0.1:8081; frame-ancestors 'none'; base-uri 'none'; "
            "form-action 'none'"
        )
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-cache"


@pytest.mark.parametrize(
    ("host", "port", "source"),
    [
        ("robot.example:8080", 8081, " http://robot.example:8081"),
        ("robot.example", 9, " http://robot.example:9"),
        ("[::1]:8080", 8081, ""),
        ("a; script-src *", 8081, ""),
        ("a\r\nb", 8081, ""),
        ("", 8081, ""),
        ("robot.example", None, ""),
    ],
)
def test_the_stops_own_way_is_named_where_it_can_be(host, port, source):
    assert stop_source(host, port) == source
    assert POLICY.format(stop=source).count(";") == 9


def test_what_the_browser_has_is_not_sent_again(client):
    etag = client.get(SCRIPT).headers["etag"]
    again = client.get(SCRIPT, headers={"If-None-Match": f'"other", {etag}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", etag)
    assert client.get(SCRIPT, headers={"If-None-Match": '"other"'}).status_code == 200


def test_files_of_any_depth_are_served_and_no_other_kind(tmp_path):
    (tmp_path / "vendor" / "deep").mkdir(parents=True)
    (tmp_path / "vendor" / "deep" / "a.mjs").write_text("1")
    (tmp_path / "vendor" / "LICENSE").write_text("do as you like")
    pages = Pages(lambda: None, tmp_path)
    request = type("Asked", (), {"headers": {}})()
    assert pages._answer("vendor/deep/a.mjs", request).headers["content-type"] == "text/javascript; charset=utf-8"
    for path in ("vendor/LICENSE", "vendor/deep", "vendor/deep/", "", "."):
        with pytest.raises(Refused):
            pages._answer(path, request)
