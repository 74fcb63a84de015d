"""The dashboard's files: served without log-in, nothing else is served, and pages have the rights they need."""

import re
from importlib import resources

import pytest

from softarm.daemon.api.endpoints.dashboard import POLICY, STOP_PORT, TYPES, DashboardFiles, stop_source

FILES = resources.files("softarm.daemon.dashboard")
PAGE = FILES.joinpath("index.html").read_text(encoding="utf-8")
LINKED = re.findall(r'(?:src|href)="(/dashboard/[^"]+)"', PAGE)
SCRIPT = next(path for path in LINKED if path.endswith("js"))


def test_the_page_requires_no_token_but_the_status_does(strict):
    answer = strict.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert answer.text == PAGE
    assert strict.get("/api/status").status_code == 401


def test_every_file_that_the_page_links_is_served(client):
    for path in LINKED:
        answer = client.get(path)
        assert answer.status_code == 200
        assert answer.headers["content-type"] == TYPES[path.rpartition(".")[2]]


OTHERS = (
    "/ /__init__.py /nothing.js /../tick.py /%2e%2e/%2e%2e/softarm.yaml //etc/passwd /..%2f..%2fapi%2fauth.py "
    "/app.js%00.html /shared /%2e%2e/api/status"
)


def test_no_other_file_is_served(strict):
    for path in OTHERS.split():
        answer = strict.get(f"/dashboard{path}")
        assert answer.status_code in (401, 404), path  # 401: the client itself has made it another path
        assert set(answer.json()) == {"detail", "reasons"}, path


def test_a_page_may_connect_to_the_daemon_and_the_stop_port_only(loop, app, client_of):
    client = client_of(app(loop, stop_port=lambda: 8081), "http://127.0.0.1:8080")
    for path in ("/", SCRIPT):
        headers = client.get(path).headers
        assert headers["content-security-policy"] == (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
            "manifest-src 'self'; frame-src 'self'; connect-src 'self' http://127.0.0.1:8081; frame-ancestors 'none'; "
            "base-uri 'none'; form-action 'none'"
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
def test_the_policy_names_the_stop_port_of_a_valid_host(host, port, source):
    assert stop_source(host, port) == source
    assert POLICY.format(stop=source).count(";") == 10


def test_an_unchanged_file_is_not_sent_again(client):
    etag = client.get(SCRIPT).headers["etag"]
    again = client.get(SCRIPT, headers={"If-None-Match": f'"other", {etag}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", etag)
    assert client.get(SCRIPT, headers={"If-None-Match": '"other"'}).status_code == 200


def test_the_page_carries_the_stop_port_for_its_script(silent, app, client_of):
    _, loop = silent
    for port in (8081, None):
        page = client_of(app(loop, stop_port=lambda port=port: port)).get("/").text
        assert STOP_PORT.format(port=port or "") in page


def test_the_page_has_at_most_250_kb():
    served = DashboardFiles(lambda: None)._files
    assert sum(len(file.content) for file in served.values()) <= 250_000
