"""GET /api/incidents: list and download of incident files, and of no other file."""

import json
import zipfile

from softarm.schemas.config import Config


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
