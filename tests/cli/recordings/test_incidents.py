"""Tests of `softarm incidents`."""

import json
import zipfile

import pytest

from softarm.cli.shared.console import clock
from softarm.daemon.logbook import incidents
from softarm.schemas.rest import IncidentEntry, IncidentsAnswer

TIMES = {
    "incident-20261122T120000Z.zip": "2026-11-22T12:00:00+00:00",
    "incident-20261121T120000Z.zip": "2026-11-21T12:00:00+00:00",
}
TEXT = "emergency stop: somebody asked for it, then run `softarm acknowledge`"


@pytest.fixture
def asked(daemon):
    entries = tuple(IncidentEntry(name=name, bytes=2_000_000, time=time, text=TEXT) for name, time in TIMES.items())
    answer = IncidentsAnswer(directory="/var/log/softarm/incidents", incidents=entries)
    daemon.on("GET", "/api/incidents", answer.model_dump(mode="json"))
    for name in TIMES:
        daemon.on("GET", f"/api/incidents/{name}", f"the file {name}".encode())
    return daemon


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "logs" / incidents.FOLDER
    place.mkdir(parents=True)
    for name, time in TIMES.items():
        with zipfile.ZipFile(place / name, "w") as archive:
            archive.comment = json.dumps({"time": time, "text": TEXT}).encode()
    return tmp_path / "logs"


def test_each_incident_is_a_line_with_its_time_and_cause(softarm, asked):
    first, second = softarm("incidents").stdout.splitlines()
    assert first.startswith(clock(TIMES["incident-20261122T120000Z.zip"]))
    assert "   2.0 MB  incident-20261122T120000Z.zip  emergency stop: " in first
    assert second.endswith("then run `softarm acknowledge`")


def test_an_incident_is_fetched_by_name_or_as_the_latest(softarm, asked, tmp_path, monkeypatch):
    result = softarm("incidents", "latest", "--out", tmp_path / "stop.zip")
    assert (result.exit_code, result.stdout) == (0, f"wrote {tmp_path / 'stop.zip'}\n")
    assert (tmp_path / "stop.zip").read_bytes() == b"the file incident-20261122T120000Z.zip"
    monkeypatch.chdir(tmp_path)
    assert softarm("incidents", "incident-20261121T120000Z.zip").exit_code == 0
    assert (tmp_path / "incident-20261121T120000Z.zip").read_bytes() == b"the file incident-20261121T120000Z.zip"


def test_incidents_of_a_folder_need_no_daemon(softarm, daemon, folder, tmp_path):
    daemon.close()
    found = json.loads(softarm("incidents", "--folder", folder, "--json").stdout)
    assert [one["name"] for one in found["incidents"]] == list(TIMES)
    assert softarm("incidents", "--folder", folder, "latest", "--out", tmp_path / "stop.zip").exit_code == 0
    with zipfile.ZipFile(tmp_path / "stop.zip") as archive:
        assert json.loads(archive.comment)["time"] == TIMES["incident-20261122T120000Z.zip"]


def test_an_unknown_incident_is_refused_with_the_nearest_name(softarm, asked, tmp_path):
    result = softarm("incidents", "incident-20261122T120001Z.zip")
    assert result.exit_code == 1
    assert "did you mean incident-20261122T120000Z.zip?" in result.stderr
    assert "there was no emergency stop" in softarm("incidents", "--folder", tmp_path).stderr
