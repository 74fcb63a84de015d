"""Download, deletion and display of logs, reports and incidents over the API, and of no other file."""

import asyncio
import itertools
import json
import os
import shutil
import socket
import threading
import time
import zipfile
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote, unquote

import httpx
import pytest

from softarm.daemon.access.sockets import holders
from softarm.daemon.api.endpoints import files
from softarm.daemon.api.endpoints.files import CHUNK_BYTES, SANDBOX
from softarm.daemon.logbook import logs
from softarm.daemon.logbook.recorder import Recorder
from softarm.recordings import log_file, player
from softarm.schemas.config import Config
from tests.processes import WAIT_S, until

FLIGHT = Path(__file__).parents[2] / "data" / "flight.mcap"
NO_NAMES = [
    "..",
    "../softarm.yaml",
    "../../etc/passwd",
    "%2e%2e%2fsecret.mcap",
    "..%2fsecret.mcap",
    "/etc/passwd",
    ".hidden.mcap",
    "none.mcap",
    "folder.mcap",
    "link.mcap",
    "pipe.mcap",
    "notes.txt",
    "a%00.mcap",
    "a%0d%0aX: y.mcap",
    "x" * 4000 + ".mcap",
    "%ff.mcap",
    "*.mcap",
]


@pytest.fixture
def config(tmp_path):
    return Config(recorder={"directory": tmp_path / "logs"}, api={"reports": tmp_path / "reports"})


@pytest.fixture
def folder(config, tmp_path):
    """Return a folder with two logs and every kind of file that is not a log."""
    made = config.recorder.directory
    made.mkdir()
    (tmp_path / "secret.mcap").write_bytes(b"secret")
    (made / "flight.mcap").write_bytes(os.urandom(3 * CHUNK_BYTES + 5))
    shutil.copy(FLIGHT, made / "real.mcap")
    (made / ".hidden.mcap").write_bytes(b"secret")
    (made / "notes.txt").write_bytes(b"secret")
    (made / "folder.mcap").mkdir()
    (made / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    os.mkfifo(made / "pipe.mcap")
    return made


@pytest.fixture
def client(loop, app, client_of, config):
    return client_of(app(loop, config))


@pytest.mark.parametrize("name", ["flight.mcap", 'a "log" of Zoë;.mcap'])
def test_a_log_with_any_name_is_downloaded_unchanged(client, folder, name):
    (folder / "flight.mcap").rename(folder / name)
    answer = client.get(f"/api/logs/{quote(name)}")
    assert answer.content == (folder / name).read_bytes()
    assert answer.headers["content-length"] == str(3 * CHUNK_BYTES + 5)
    assert answer.headers["content-disposition"] == f"attachment; filename*=UTF-8''{quote(name)}"
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["content-type"] == "application/octet-stream"


def test_a_growing_log_is_downloaded_at_its_first_length(config, folder, monkeypatch, loop, app, client_of):
    path, before = folder / "flight.mcap", (folder / "flight.mcap").read_bytes()
    opened = files._opened

    def and_more(asked):
        found = opened(asked)
        with path.open("ab") as file:
            file.write(b"more")
        return found

    monkeypatch.setattr(files, "_opened", and_more)
    answer = client_of(app(loop, config)).get("/api/logs/flight.mcap")
    assert answer.content == before


@pytest.mark.parametrize("method", ["GET", "DELETE", "POST"])
def test_no_other_file_is_downloaded_deleted_or_used_by_a_job(client, folder, tmp_path, method):
    before = sorted(tmp_path.rglob("*"))
    for name in NO_NAMES:
        if method == "POST":
            answer = client.post("/api/jobs", json={"kind": "replay", "log": unquote(name)})
        else:
            answer = client.request(method, f"/api/logs/{name}")
        assert answer.status_code in (404, 405, 409), name
        assert "secret" not in answer.text.replace(name, "").replace("secret.mcap", ""), name
        assert answer.json()["reasons"], name
        assert sorted(tmp_path.rglob("*")) == before, name


@pytest.mark.slow
def test_simultaneous_downloads_are_limited_and_an_ended_one_makes_room(
    loop, app, serving, config, folder, monkeypatch
):
    monkeypatch.setattr(files, "DOWNLOADS_MAX", 1)
    os.truncate(folder / "flight.mcap", 64_000_000)
    with serving(app(loop, config), config.api.model_copy(update={"port": 0})) as port:
        url = f"http://127.0.0.1:{port}/api/logs/flight.mcap"
        with httpx.stream("GET", url, timeout=WAIT_S) as slow:
            assert slow.status_code == 200
            refused = httpx.get(url, timeout=WAIT_S)
            assert refused.status_code == 503
            assert "1 downloads are running already" in refused.text
        until(lambda: len(httpx.get(url, timeout=WAIT_S).content) == 64_000_000)
    assert not is_open(folder / "flight.mcap")


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("GET", "/api/logs/none.mcap/view", None),
        ("POST", "/api/jobs", {"kind": "replay", "log": "none.mcap"}),
        ("POST", "/api/jobs", {"kind": "diagnose", "logs": ["none.mcap"]}),
    ],
)
def test_a_slow_disk_delays_no_other_request(client, folder, monkeypatch, method, path, body):
    threads, opened = [], files._opened
    monkeypatch.setattr(files, "_opened", lambda path: (threads.append(threading.current_thread()), opened(path))[1])
    assert client.request(method, path, json=body).status_code == 404
    assert threads != []
    assert threading.main_thread() not in threads  # runs the event loop here


def test_downloads_that_begin_together_are_limited_too(loop, app, config, folder, monkeypatch):
    monkeypatch.setattr(files, "DOWNLOADS_MAX", 1)
    opened = files._opened
    monkeypatch.setattr(files, "_opened", lambda path: (time.sleep(0.2), opened(path))[1])

    async def both(made):
        async with httpx.AsyncClient(transport=httpx.ASGITransport(made), base_url="http://127.0.0.1") as client:
            return await asyncio.gather(*(client.get("/api/logs/flight.mcap") for _ in range(2)))

    assert sorted(answer.status_code for answer in asyncio.run(both(app(loop, config)))) == [200, 503]


def is_open(path: Path) -> bool:
    """Return whether this process has a file open."""
    return Path("/proc", str(os.getpid())) in holders({str(path)})


@pytest.mark.slow
def test_a_client_that_does_not_read_its_download_is_disconnected(loop, app, serving, config, folder, monkeypatch):
    monkeypatch.setattr("softarm.daemon.api.bounds.UNREAD_S", 0.3)
    os.truncate(folder / "flight.mcap", 64_000_000)
    with serving(app(loop, config), config.api.model_copy(update={"port": 0})) as port:
        deaf = socket.create_connection(("127.0.0.1", port), timeout=WAIT_S)
        deaf.sendall(b"GET /api/logs/flight.mcap HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        until(lambda: is_open(folder / "flight.mcap"))
        until(lambda: not is_open(folder / "flight.mcap"))
        taken = 0
        with suppress(ConnectionResetError):
            while part := deaf.recv(1_000_000):
                taken += len(part)
        deaf.close()
        assert taken < 64_000_000


@pytest.mark.slow
def test_a_deletion_is_recorded_with_its_source(loop, app, client_of, config, folder):
    recorder = Recorder(config)
    recorder.start()
    client = client_of(app(loop, config, recorder=recorder, history=recorder.history))
    try:
        refused = client.request("DELETE", f"/api/logs/{recorder.path.name}")
        assert (refused.status_code, "is being recorded" in refused.json()["detail"]) == (409, True)
        answers = (client.request("DELETE", "/api/logs/flight.mcap") for _ in itertools.count())
        answer = next(each for each in answers if each.status_code != 409)  # until the recorder has looked at it
        assert (answer.status_code, answer.json()) == (200, {"name": "flight.mcap"})
        assert not (folder / "flight.mcap").exists()
        assert client.request("DELETE", "/api/logs/flight.mcap").status_code == 404
    finally:
        recorder.stop()
    (event,) = client.get("/api/events").json()["events"]
    assert (event["kind"], event["what"], event["accepted"], event["who"]) == ("request", "delete_log", True, "the API")
    assert event["text"] == "delete log flight.mcap requested from the API"
    assert [entry.text for entry in logs.read(recorder.path).entries()] == [event["text"]]


def test_a_log_that_another_daemon_writes_is_not_deleted(client, folder):
    with (folder / "flight.mcap").open("rb") as file:
        log_file.hold(file.fileno())
        assert client.request("DELETE", "/api/logs/flight.mcap").status_code == 409
    assert client.request("DELETE", "/api/logs/flight.mcap").status_code == 200


@pytest.mark.slow
def test_a_player_page_that_takes_too_long_is_ended_and_makes_room(client, folder, monkeypatch, verb_runs):
    monkeypatch.setattr(files, "VIEW_S", 1.0)
    verb_runs("signal.pause()")
    for _ in range(2):
        answer = client.get("/api/logs/real.mcap/view")
        assert answer.status_code == 504
        assert "not finished within 1 s" in answer.json()["detail"]


@pytest.mark.slow
def test_a_player_page_whose_client_left_is_ended(loop, app, serving, config, folder, verb_runs):
    """The first process does not end by itself; the others write a page at once."""
    started = folder / "real.mcap.started"
    verb_runs(
        "try: open(sys.argv[3] + '.started', 'x')\n"
        "except FileExistsError: open(sys.argv[-1], 'w').write('at once')\n"
        "else: signal.pause()\n"
    )
    with serving(app(loop, config), config.api.model_copy(update={"port": 0})) as port:
        with socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as leaving:
            leaving.sendall(b"GET /api/logs/real.mcap/view HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            until(started.exists)
        url = f"http://127.0.0.1:{port}/api/logs/real.mcap/view"
        until(lambda: httpx.get(url, timeout=WAIT_S).status_code == 200)


@pytest.mark.slow
def test_a_log_is_viewed_as_a_sandboxed_page(client, folder):
    answer = client.get("/api/logs/real.mcap/view")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert answer.headers["content-security-policy"] == SANDBOX
    log = logs.read(folder / "real.mcap")
    assert answer.text == player.page(log, log.entries())
    refused = client.get("/api/logs/flight.mcap/view")  # of random bytes
    assert (refused.status_code, "flight.mcap" in refused.json()["detail"]) == (422, True)
    assert client.get("/api/logs/none.mcap/view").status_code == 404


def test_reports_are_shown_in_a_sandbox(client, config):
    assert client.get("/api/reports").json()["reports"] == []
    config.api.reports.mkdir()
    page = "<!doctype html><script>1</script>"
    (config.api.reports / "gap of 1 May.html").write_text(page)
    (config.api.reports / "verdict.json").write_text("{}")
    (entry,) = client.get("/api/reports").json()["reports"]
    assert (entry["name"], entry["bytes"]) == ("gap of 1 May.html", len(page))
    answer = client.get("/api/reports/gap of 1 May.html")
    assert (answer.text, answer.headers["content-type"]) == (page, "text/html; charset=utf-8")
    assert answer.headers["content-security-policy"] == SANDBOX
    assert SANDBOX.startswith("sandbox allow-scripts;")
    assert "allow-same-origin" not in SANDBOX
    for name in ("verdict.json", "../softarm.yaml", "none.html"):
        assert client.get(f"/api/reports/{name}").status_code == 404


def test_incident_files_and_no_others_are_listed_and_downloaded(loop, app, client_of, tmp_path):
    client = client_of(app(loop, Config(recorder={"directory": tmp_path})))
    assert client.get("/api/incidents").json()["incidents"] == []
    (tmp_path / "incidents").mkdir()
    (tmp_path / "incidents" / "secret.txt").write_text("a secret")
    (tmp_path / "incidents" / "incident-20260102T000000Z.zip").write_bytes(b"no zip")
    (tmp_path / "secret.mcap").write_text("a log")
    name = "incident-20260101T000000Z.zip"
    with zipfile.ZipFile(tmp_path / "incidents" / name, "w") as archive:
        archive.comment = json.dumps({"time": "2026-01-01T00:00:00+00:00", "text": "emergency stop: a hand"}).encode()
        archive.writestr("README.txt", "read me")
    answer = client.get("/api/incidents").json()
    (entry,) = answer["incidents"]
    assert answer["directory"] == str(tmp_path / "incidents")
    assert (entry["name"], entry["text"], entry["time"]) == (name, "emergency stop: a hand", "2026-01-01T00:00:00Z")
    given = client.get(f"/api/incidents/{name}")
    assert (given.status_code, given.headers["content-type"]) == (200, "application/zip")
    assert given.headers["content-disposition"] == f'attachment; filename="{name}"'
    assert given.content == (tmp_path / "incidents" / name).read_bytes()
    for other in (name.replace("2026", "2025"), "secret.txt", "..%2Fsecret.mcap", "x" * 300):
        refused = client.get(f"/api/incidents/{other}")
        assert refused.status_code == 404
    assert refused.json()["detail"] == f"no incident file '{'x' * 60}'; GET /api/incidents lists them"
