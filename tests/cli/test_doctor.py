"""`softarm doctor`: every part, and the exit code."""

import json

import pytest

from softarm.daemon.control.records import Mode
from softarm.daemon.doctor import clocks, disk, examination, models, scheduling
from softarm.schemas.rest import API_HEADER


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A configuration without wires, and a computer that is as quick as any, whatever else runs on it."""
    monkeypatch.chdir(tmp_path)
    calm = scheduling.Scheduling(20, True, float("inf"), 2, 0.0, frozenset(), (0.1,) * 10)
    monkeypatch.setattr(scheduling, "look", lambda priority: calm)
    monkeypatch.setattr(disk, "speed", lambda folder: (200e6, 5.0))
    monkeypatch.setattr(models, "timed", lambda policy: (1.0,))
    monkeypatch.setattr(clocks, "look", lambda: clocks.Clocks(0.0, 0.5, True, 0.1, "tsc"))
    (tmp_path / "softarm.yaml").write_text("api: {port: 0}\nrecorder: {directory: logs}\n")
    return tmp_path


@pytest.mark.slow
def test_beside_a_daemon_it_tells_what_that_says(softarm, daemon, bench, make_status):
    here = {"rail_position_m": 0.02, "rail_velocity_m_s": 0.0, "arming_refusals": ("no: POST /api/acknowledge",)}
    daemon.on("GET", "/api/status", make_status(mode=Mode.DISARMED, **here))
    done = softarm("doctor", "--config", "softarm.yaml", "--simulated")
    assert "rail's zero: the axis is +8.0 mm from motion capture here" in done.output
    assert "no: `softarm acknowledge`" in done.output
    assert "no reading yet" in done.output
    assert done.exit_code == 1
    assert {path for _, path, _ in daemon.requests} == {"/api/status"}
    assert {method for method, _, _ in daemon.requests} == {"GET"}
    assert "this does not fly yet" in done.output
    assert all(f"\n{part}\n" in done.output for part in examination.PARTS)


@pytest.mark.slow
def test_beside_an_arm_in_use_nothing_heavy_is_done(softarm, daemon, bench, make_status):
    daemon.on("GET", "/api/status", make_status(mode=Mode.ARMED))
    told = json.loads(softarm("doctor", "--config", "softarm.yaml", "--json").output)["findings"]
    figures = {each["name"]: each["figure"] for each in told}
    assert "not measured" in figures["policy"]
    assert "not measured" in figures["disk's speed"]
    assert "regulator" in figures  # as the daemon says; the device is not looked at
    assert "/dev/serial" not in figures["regulator"]


def test_where_nobody_answers_it_looks_whether_a_daemon_could_begin(softarm, bench):
    done = softarm("doctor", "--config", "softarm.yaml", "--simulated", "--url", "http://127.0.0.1:9", "--json")
    told = json.loads(done.output)
    assert {each["part"] for each in told["findings"]} == set(examination.PARTS)
    (wires,) = [each["figure"] for each in told["findings"] if each["part"] == "robot and daemon"]
    assert wires == "none answers at http://127.0.0.1:9: what follows is whether one could begin"
    assert [each for each in told["findings"] if each["state"] == "problem"] == []
    assert (done.exit_code, told["sound"]) == (0, True)


def test_a_problem_is_told_with_what_to_do(softarm, bench):
    (bench / "softarm.yaml").write_text("control: {polcy: reach}\n")
    done = softarm("doctor", "--config", "softarm.yaml", "--simulated", "--url", "http://127.0.0.1:9")
    assert done.exit_code == 1
    assert "problem  configuration: softarm.yaml:1: control.polcy: unknown key; did you mean policy?" in done.output
    assert "-> correct it" in done.output


def test_a_daemon_that_wants_a_token_is_known_as_one(softarm, daemon, bench):
    daemon.on("GET", "/api/status", {"detail": "a token is needed"}, code=401)
    daemon.says[API_HEADER] = "1"
    done = softarm("doctor", "--config", "softarm.yaml", "--simulated")
    assert "a token is needed" in done.output
    assert "--token-file" in done.output


def test_another_program_is_no_daemon(softarm, daemon, bench):
    daemon.on("GET", "/api/status", {"hello": "you"})
    done = softarm("doctor", "--config", "softarm.yaml", "--simulated", "--json")
    said = {each["name"]: each["figure"] for each in json.loads(done.output)["findings"]}
    assert "none answers" in said["daemon"]


@pytest.mark.parametrize("url", ["robot:8080", "http://robot:port", "ftp://robot"])
def test_what_is_no_address_is_refused(softarm, bench, url):
    done = softarm("doctor", "--config", "softarm.yaml", "--url", url)
    assert done.exit_code == 2
    assert "http://127.0.0.1:8080" in done.output
