"""Tests of `softarm doctor`."""

import json
import re
from types import SimpleNamespace

import pytest

from softarm.daemon.control.records import Mode
from softarm.daemon.doctor import clocks, disk, examination, models, running, scheduling, untried
from softarm.schemas.rest import API_HEADER


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """Return a folder with a configuration, on a computer with fixed measured speeds."""
    monkeypatch.chdir(tmp_path)
    calm = scheduling.Scheduling(20, True, float("inf"), 2, 0.0, frozenset(), (0.1,) * 10)
    monkeypatch.setattr(scheduling, "look", lambda priority: calm)
    monkeypatch.setattr(disk, "speed", lambda folder: (200e6, 5.0))
    monkeypatch.setattr(models, "timed", lambda policy: (1.0,))
    monkeypatch.setattr(running, "time", SimpleNamespace(sleep=lambda seconds: None))
    monkeypatch.setattr(clocks, "look", lambda: clocks.Clocks(0.0, 0.5, True, 0.1, "tsc"))
    (tmp_path / "softarm.yaml").write_text("api: {port: 0}\nrecorder: {directory: logs}\n")
    return tmp_path


@pytest.mark.slow
def test_the_state_of_a_running_daemon_is_checked(softarm, daemon, bench, make_status):
    here = {"rail_position_m": 0.02, "rail_velocity_m_s": 0.0, "arming_refusals": ("the drive is off",)}
    daemon.on("GET", "/api/status", make_status(mode=Mode.DISARMED, **here))
    done = softarm("doctor", "--config", "softarm.yaml", "--simulated")
    assert "rail's zero: the axis is +8.0 mm from motion capture here" in done.output
    assert "problem  arming: the drive is off" in done.output
    assert "no reading yet" in done.output
    assert done.exit_code == 1
    assert {path for _, path, _ in daemon.requests} == {"/api/status"}
    assert {method for method, _, _ in daemon.requests} == {"GET"}
    assert "not ready to fly" in done.output
    hardware = ("limits", "never used with hardware")
    assert all((f"\n{part}\n" in done.output) is (part not in hardware) for part in examination.PARTS)


@pytest.mark.slow
def test_an_armed_arm_prevents_measurements_that_cost_time(softarm, daemon, bench, make_status):
    daemon.on("GET", "/api/status", make_status(mode=Mode.ARMED))
    answer = json.loads(softarm("doctor", "--config", "softarm.yaml", "--json").output)["findings"]
    figures = {each["name"]: each["figure"] for each in answer}
    assert "not timed" in figures["policy"]
    assert "not measured" in figures["disk's speed"]
    assert "regulator" in figures  # as the daemon says; the device is not looked at
    assert "/dev/serial" not in figures["regulator"]


def test_without_a_daemon_the_start_of_one_is_checked(softarm, bench):
    done = softarm("doctor", "--config", "softarm.yaml", "--simulated", "--url", "http://127.0.0.1:9", "--json")
    answer = json.loads(done.output)
    assert {each["part"] for each in answer["findings"]} == set(examination.PARTS) - {
        "limits",
        "never used with hardware",
    }
    (wires,) = [each["figure"] for each in answer["findings"] if each["part"] == "robot and daemon"]
    assert wires == "no daemon at http://127.0.0.1:9, so the following checks whether one can start"
    assert [each for each in answer["findings"] if each["state"] == "problem"] == []
    assert (done.exit_code, answer["sound"]) == (0, True)


def test_a_daemon_that_requires_a_token_is_recognised(softarm, daemon, bench):
    daemon.on("GET", "/api/status", {"detail": "a token is needed"}, code=401)
    daemon.extra_headers[API_HEADER] = "1"
    done = softarm("doctor", "--config", "softarm.yaml", "--simulated")
    assert "a token is needed" in done.output
    assert "--token-file" in done.output


def test_the_token_of_the_configuration_is_sent_to_its_own_daemon_only(softarm, daemon, bench, monkeypatch):
    sent = []
    monkeypatch.delenv("SOFTARM_URL")
    monkeypatch.setattr(running, "look", lambda url, token: sent.append(token))
    (bench / "token").write_text("t" * 16)
    (bench / "token").chmod(0o600)
    (bench / "softarm.yaml").write_text("api: {port: 0, token_file: token}\n")
    softarm("doctor", "--config", "softarm.yaml", "--simulated")
    softarm("doctor", "--config", "softarm.yaml", "--simulated", "--url", "http://127.0.0.1:9")
    assert sent == ["t" * 16, None]


def test_another_program_is_not_taken_for_a_daemon(softarm, daemon, bench):
    daemon.on("GET", "/api/status", {"hello": "you"})
    done = softarm("doctor", "--config", "softarm.yaml", "--simulated", "--json")
    figures = {each["name"]: each["figure"] for each in json.loads(done.output)["findings"]}
    assert "no daemon at" in figures["daemon"]


def test_a_simulated_robot_needs_no_hardware_and_no_file(softarm, bench):
    done = softarm("doctor", "--simulated", "--url", "http://127.0.0.1:9", "--json")
    findings = json.loads(done.output)["findings"]
    hardware = re.compile("excite|--config|service install|/dev/|unknown, softarm")
    assert [each for each in findings if hardware.search(each["figure"] + each["advice"])] == []
    assert {each["name"] for each in findings}.isdisjoint({"limits.rail", "regulator", "rail", "real-time priority"})


def test_the_parts_without_hardware_tests_are_listed(softarm, bench):
    done = softarm("doctor", "--config", "softarm.yaml", "--url", "http://127.0.0.1:9")
    assert all(sentence in done.output for sentence in untried.sentences().values())
